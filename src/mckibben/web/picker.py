"""Column picker: the first rows of a file, above each column what it is read as, and the questions about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from nicegui import ui

from mckibben.dataset import TOPICS, Question, Table
from mckibben.dataset.vocabulary import QUANTITIES
from mckibben.errors import printable
from mckibben.web.layout import button, quiet, select
from mckibben.web.reading import WORDS, ColumnChoice, ReadingFields


class ColumnPicker:
    """The picker of a file.

    Parameters
    ----------
    table
        What was understood of the file.
    fields
        Fields of reading, which the picker changes.
    questions
        What is not plain.
    changed
        Called after each change of the fields.
    """

    def __init__(
        self, table: Table, fields: ReadingFields, questions: Sequence[Question], changed: Callable[[], None]
    ) -> None:
        self.table, self.fields, self.questions, self.changed = table, fields, questions, changed
        self.ranges = {row[0]: row[4:] for row in table.rows()}
        placed = [question for header in table.head for question in self.about(header)]
        for question in questions:
            if question not in placed:
                self.ask(question, self.accepting(question), remedy=True)
        with ui.row().classes("picker no-wrap items-stretch").mark("picker"):
            for header in list(table.head)[:60]:
                self.column(header)

    def about(self, header: str) -> list[Question]:
        """Questions about a column: by its header, or by its quantity."""
        mine = {header, *(name for name, column in self.table.columns.items() if column.header == header)}
        return [question for question in self.questions if question.problem.field in mine]

    def column(self, header: str) -> None:
        """A column: what it is read as, questions, range, and its first cells."""
        choice = ColumnChoice.of(header, self.table, self.fields.columns)
        asked, name = self.about(header), printable(header, 80)
        state = "asked" if asked else "" if choice.quantity else "unused"
        with ui.column().classes(f"picked {state}").style("gap: 2px"):
            ui.label(name).classes("column-name")
            self.choose(header, choice, "quantity", WORDS)
            if units := QUANTITIES.get(choice.quantity, ()):
                with ui.row().classes("no-wrap w-full").style("gap: 8px"):
                    self.choose(header, choice, "unit", {unit: unit for unit in units})
                    if choice.quantity != "time":
                        self.choose(header, choice, "turned", {False: "as it is", True: "reversed"}, "sign")
            if "pressure" in choice.quantity:
                self.choose(header, choice, "absolute", {False: "gauge", True: "absolute"}, "reference")
            for question in asked[:3]:
                at_column = question.topic in ("", "columns")
                self.ask(question, self.answers(header, choice) if at_column else self.accepting(question))
            for text in filter(None, self.ranges.get(name, ())):
                quiet(text)
            ui.space()
            for cell in self.table.head[header]:
                ui.label(printable(cell if isinstance(cell, str) else f"{cell:.6g}", 24)).classes("cell number")

    def choose(
        self, header: str, choice: ColumnChoice, part: str, options: dict[str, str] | dict[bool, str], label: str = ""
    ) -> None:
        """A select for a part of a choice, named for screen readers by the column."""
        value = getattr(choice, part)
        element = select(
            options,
            label or part,
            f"{part}-{header}",
            value=value if value in options else None,
            on_change=lambda event: self.set(header, choice.changed(**{part: event.value})),
        )
        element.props(f'aria-label="{part} of {printable(header, 60).replace(chr(34), "")}" options-dense')

    def set(self, header: str, choice: ColumnChoice) -> None:
        """Read a column as another choice says."""
        if not self.table.columns:  # its header is found by these names alone
            self.fields.columns = dict.fromkeys(self.table.head, "ignore") | self.fields.columns
        self.fields.columns[header] = choice.name
        self.changed()

    def answers(self, header: str, choice: ColumnChoice) -> dict[str, Callable[[], None]]:
        """Answers to a question about a column that no topic answers."""

        def pick(answer: ColumnChoice) -> Callable[[], None]:
            return lambda: self.set(header, answer)

        def give_ambient() -> None:
            self.fields.ambient = "101.3 kPa"
            self.changed()

        if choice.quantity == "displacement":
            return {WORDS[way]: pick(choice.changed(quantity=way)) for way in ("shortening", "lengthening")}
        if choice.absolute and not self.fields.ambient:
            return {"ambient 101.3 kPa": give_ambient, "it is gauge": pick(choice.changed(absolute=False))}
        unused = {"not used": pick(ColumnChoice(""))}
        if choice.quantity in self.table.columns:  # its numbers cannot be those of a muscle
            return {"reverse its sign": pick(choice.changed(turned=not choice.turned)), **unused}
        names = [choice.quantity] if choice.quantity else [name for name in WORDS if name != "displacement"]
        fitting = [name for name in names if choice.unit in QUANTITIES.get(name, ())]
        return {f"take it as {WORDS[name]}": pick(choice.changed(quantity=name)) for name in fitting} | unused

    def accepting(self, question: Question) -> dict[str, Callable[[], None]]:
        """The answer "yes" to a question with a topic."""

        def accept() -> None:
            self.fields.accept = tuple(dict.fromkeys((*self.fields.accept, question.topic)))
            self.changed()

        return {f"yes: {TOPICS[question.topic]}": accept} if question.topic else {}

    def ask(self, question: Question, answers: dict[str, Callable[[], None]], *, remedy: bool = False) -> None:
        """A question with its answers as buttons."""
        problem = question.problem
        with ui.column().classes("question").style("gap: 2px").mark("question"):
            place = "" if problem.line is None else f"line {problem.line}: "
            named = f"{problem.field.replace('_', ' ')} " if remedy and problem.field else ""
            ui.label(printable(f"{place}{named}{problem.message}", 400))
            for text, answer in answers.items():
                button(text, answer).props("dense outline align=left").mark("answer")
            if remedy and not answers:
                quiet(printable(problem.remedy, 600))
