"""Writer of the statements of a graph, in the syntax of C99 and JavaScript."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from mckibben.codegen.graph import Branch, Carried, ForLoop, Kind, Scope, StoredArray, Value, needed
from mckibben.codegen.source_module import identifier

_LONGEST = 100  # characters of an expression without its own variable
ATOM, PREFIX, _PRODUCT, _SUM, _COMPARISON, _AND, _OR, _CHOICE = range(8, 0, -1)
_INFIX = {
    "add": ("+", _SUM),
    "sub": ("-", _SUM),
    "mul": ("*", _PRODUCT),
    "div": ("/", _PRODUCT),
    "lt": ("<", _COMPARISON),
    "le": ("<=", _COMPARISON),
    "gt": (">", _COMPARISON),
    "ge": (">=", _COMPARISON),
    "eq": ("==", _COMPARISON),
    "ne": ("!=", _COMPARISON),
    "and": ("&&", _AND),
    "or": ("||", _OR),
    "xor": ("!=", _COMPARISON),
    "shift_left": ("<<", _COMPARISON),
    "shift_right": (">>", _COMPARISON),
    "shift_word": (">>", _COMPARISON),
}
_BITWISE = {"and": "&", "or": "|", "xor": "^"}
_OF_INTEGERS = {
    "abs": "{0} < 0 ? -{0} : {0}",
    "rem": "{0} % {1}",
    "max": "{0} > {1} ? {0} : {1}",
    "min": "{0} < {1} ? {0} : {1}",
    "sign": "({0} > 0) - ({0} < 0)",
}
Text = tuple[str, int]
"""Text of an expression, and the precedence of its outermost operator."""


@dataclass(frozen=True, slots=True)
class Language:
    """Syntax of a programming language.

    Attributes
    ----------
    types, constants
        Declarations of variables and of constants, by kind.
    functions
        Names of functions, by operation.
    helpers
        Definitions of functions that the language lacks, by name; those in use are written.
    literal
        Text of a number of a kind.
    conversion
        Text of an atom of one kind as one of another.
    array
        Declaration of an array: name, kind, size, texts of the elements if known, whether they are constant.
    """

    types: Mapping[Kind, str]  # declarations of variables
    constants: Mapping[Kind, str]  # declarations of constants
    functions: Mapping[str, str]  # by operation
    helpers: Mapping[str, str]  # definitions of functions that the language lacks, by name
    literal: Callable[[float, Kind], str]
    conversion: Callable[[str, Kind, Kind], str]  # text of an atom, from one kind to another
    array: Callable[[str, Kind, int, Sequence[str] | None, bool], str]  # declaration


class Writer:
    """Writes scopes, and keeps the text of each value written.

    A value that is used once is written where it is used, if its text is short; others get a variable. Values on which
    no result depends are not written.

    Parameters
    ----------
    scopes
        All scopes that will be written: uses are counted first.
    results
        Values and arrays that are results; they have names.
    wide, wide_language
        Identities of values in another precision, and the language for that.

    Attributes
    ----------
    helpers
        Definitions of the functions in use that the language lacks.
    shared
        Identities of values that are results, or used outside their scope.
    """

    def __init__(
        self,
        scopes: Sequence[Scope],
        language: Language,
        results: Sequence[Value | StoredArray],
        wide: Collection[int] = (),  # identities of values that are in another precision
        wide_language: Language | None = None,
    ) -> None:
        self.language = language
        self._wide = wide
        self._wide_language = wide_language or language
        self.helpers: set[str] = set()
        self._needed = needed(results)
        self._texts: dict[int, Text] = {}
        self._carried: dict[int, str] = {}  # names
        self._arrays: dict[int, str] = {}
        self._names: Counter[str] = Counter()
        self._uses: Counter[int] = Counter(id(result) for result in results for _ in range(2))  # results have names
        self.shared = {id(result) for result in results}
        """Identities of values that are results, or used outside their scope."""
        for scope in scopes:
            self._count(scope)

    def name(self, value: Value, text: str) -> None:
        """Set the text of a value, such as that of the place where it lies."""
        self._texts[id(value)] = (text, ATOM)

    def text(self, value: Value) -> str:
        """Text of a value already written."""
        return self._text(value)[0]

    def name_array(self, array: StoredArray, text: str) -> None:
        """Register the name of an array declared elsewhere."""
        self._arrays[id(array)] = text

    def constant(self, value: Value) -> str:
        """Declared type of a value."""
        return self._language(value).constants[value.kind]

    def _is_wide(self, value: Value) -> bool:
        """Whether a value is in the other precision."""
        return id(value) in self._wide

    def _language(self, value: Value) -> Language:
        """Language of a value, by its precision."""
        return self._wide_language if self._is_wide(value) else self.language

    def is_needed(self, value: Value) -> bool:
        """Whether results depend on a value."""
        return id(value) in self._needed

    def scope(self, scope: Scope, indent: str = "    ", stored: Callable[[Value], str] | None = None) -> list[str]:
        """Lines of a scope with named inputs; `stored` gives the destination of values for other scopes."""
        lines = []
        for statement in scope.statements:
            if isinstance(statement, ForLoop):
                lines += self._loop(statement, indent)
            elif isinstance(statement, Branch):
                lines += self._branch(statement, indent)
            elif id(statement) not in self._needed or id(statement) in self._texts:
                continue
            elif isinstance(statement, StoredArray):
                texts = [self.converted(element, statement.uniform) for element in statement.elements]
                lines += self._array(statement, texts, indent)
            else:
                lines += self._value(statement, indent, stored)
        return lines

    def prepared(self, scope: Scope, place_of: Callable[[str], str], store: str) -> tuple[list[str], list[int]]:
        """Lines that compute what follows from parameters alone, and how many numbers of each kind they store.

        Parameters
        ----------
        scope
            The root of a graph, whose inputs are the parameters.
        place_of
            Text of a parameter by the name of its input.
        store
            Place of a stored number, such as ``self->prepared.{}[{}]``, of its kind and its index among those.
        """
        counts = dict.fromkeys(Kind, 0)

        def stored(value: Value) -> str:
            counts[value.kind] += 1
            return store.format(value.kind.value, counts[value.kind] - 1)

        for value in inputs_of(scope):
            self.name(value, place_of(value.data))
        return self.scope(scope, stored=stored), list(counts.values())

    def function(self, scope: Scope, place_of: Callable[[str], str]) -> list[str]:
        """Lines of a function: its inputs as variables, from the texts of their places by name, and its statements."""
        lines = []
        for value in inputs_of(scope):
            if self.is_needed(value):
                name, place = identifier(value.data), place_of(value.data)
                self.name(value, name)
                lines += [f"    {self.constant(value)} {name} = {place};"] if name != place else []
        return lines + self.scope(scope)

    def _value(self, value: Value, indent: str, stored: Callable[[Value], str] | None) -> list[str]:
        """Line that declares or stores a value; none for one that is written where it is used."""
        text = self._expression(value)
        if stored is not None and id(value) in self.shared:
            self.name(value, stored(value))
            return [f"{indent}{self.text(value)} = {text[0]};"]
        if self._uses[id(value)] < 2 and len(text[0]) <= _LONGEST:
            self._texts[id(value)] = text
            return []
        name = self.new_name("t", value.uniform)
        self.name(value, name)
        return [f"{indent}{self.constant(value)} {name} = {text[0]};"]

    def _loop(self, loop: ForLoop, indent: str) -> list[str]:
        """Lines of a loop with the variables and arrays that are needed."""
        variables = [variable for variable in loop.carried if id(variable) in self._needed]
        arrays = [array for array in loop.arrays if id(array) in self._needed]
        if not variables and not arrays:
            return []
        lines = []
        for array in arrays:
            if id(array) not in self._arrays:
                lines += self._array(array, None, indent)
        for variable in variables:
            name = self._carried[id(variable)] = self.new_name("x", variable.uniform)
            initial = self.converted(variable.initial, variable.uniform)
            kind = self.variable(variable.initial.kind, variable.uniform)
            lines.append(f"{indent}{kind} {name} = {initial};")
        index, inside = self.new_name("i"), indent + "    "
        self.name(loop.index, index)
        going = f"{index} < {loop.length}" if loop.going is None else self._carried[id(loop.going)]
        lines.append(f"{indent}for ({self.language.types[Kind.INTEGER]} {index} = 0; {going}; ++{index}) {{")
        lines += self.scope(loop.scope, inside)
        for array in arrays:
            for place, element in enumerate(array.elements):
                at = self._place(loop.row, len(array.elements), place)
                lines.append(f"{inside}{self.store(array, at, element)};")
        lines += [f"{inside}{line}" for line in self._updates(variables)]
        return [*lines, f"{indent}}}"]

    def _updates(self, variables: Sequence[Carried]) -> list[str]:
        """Lines that set the variables of a loop to their next values; those that are exchanged by way of copies."""
        lines, copies = [], {}
        for variable in variables:
            target, following = self._carried[id(variable)], variable.following
            if following.operation == "carried" and self.text(following) != target:
                copies[target] = self.new_name("t", variable.uniform)
                kind = self.variable(following.kind, variable.uniform)
                lines.append(f"{kind} {copies[target]} = {self.converted(following, variable.uniform)};")
        for variable in variables:
            target = self._carried[id(variable)]
            text = copies.get(target) or self.converted(variable.following, variable.uniform)
            if text != target:
                lines.append(f"{target} = {text};")
        return lines

    def _branch(self, branch: Branch, indent: str) -> list[str]:
        """Lines of a branch, whose results are variables declared before it."""
        chosen = [value for value in branch.chosen if id(value) in self._needed]
        if not chosen:
            return []
        lines = []
        for value in chosen:
            self.name(value, self.new_name("y", value.uniform))
            lines.append(f"{indent}{self.variable(value.kind, value.uniform)} {self.text(value)};")
        heads = f"if ({self.text(branch.condition)}) {{", "} else {"
        for head, scope, values in zip(heads, branch.scopes, branch.values, strict=True):
            lines.append(indent + head)
            lines += self.scope(scope, indent + "    ")
            for value in chosen:
                result = self.converted(values[value.data[1]], value.uniform)
                lines.append(f"{indent}    {self.text(value)} = {result};")
        return [*lines, f"{indent}}}"]

    def variable(self, kind: Kind, uniform: bool) -> str:
        """Declared type of a variable, which may be uniform over lanes."""
        return self.language.types[kind]

    def converted(self, value: Value, uniform: bool) -> str:
        """Text of a value as assigned to a variable, which may be less precise."""
        precise = self._wide_language.types[value.kind]
        if value.kind is Kind.REAL and self._is_wide(value) and self.variable(value.kind, uniform) != precise:
            return self.language.conversion(_bound(self._text(value), ATOM), Kind.REAL, Kind.REAL)
        return self.text(value)

    def loaded(self, value: Value) -> str:
        """Text of an argument in memory."""
        return f"{value.data}[0]"

    def store(self, array: StoredArray, place: str, value: Value) -> str:
        """Text of the assignment to an element of an array."""
        return f"{self._arrays[id(array)]}[{place}] = {self.text(value)}"

    def element(self, array: StoredArray, place: str) -> str:
        """Text of an element of an array."""
        return f"{self._arrays[id(array)]}[{place}]"

    def _array(self, array: StoredArray, texts: Sequence[str] | None, indent: str) -> list[str]:
        """Line that declares an array."""
        name = self._arrays[id(array)] = self.new_name("a")
        return [f"{indent}{self.language.array(name, array.kind, array.size, texts, array.constant)}"]

    def _place(self, row: Value | None, stride: int, offset: int) -> str:
        """Text of a position in an array."""
        if row is None:
            return str(offset)
        text, strength = self._text(row)
        if stride != 1:
            text = f"{stride} * {text if strength >= PREFIX else f'({text})'}"
        return f"{text} + {offset}" if offset else text

    def _text(self, value: Value) -> Text:
        """Text of a value, and its precedence."""
        if value.operation == "constant":
            return self._literal(value, self.language)
        if value.operation == "carried":
            return self._carried[id(value.data)], ATOM
        return self._texts[id(value)]

    def _literal(self, value: Value, language: Language) -> Text:
        """Text of a number; a negative one has the precedence of its sign."""
        literal = language.literal(value.data, value.kind)
        return literal, PREFIX if literal.startswith("-") else ATOM

    def _expression(self, value: Value) -> Text:
        """Text of an operation, from the texts of its arguments, or of an element."""
        if value.operation == "element":
            place = self._place(value.arguments[0] if value.arguments else None, value.data.stride, value.data.offset)
            return self.element(value.data.array, place), ATOM
        return self._operation(value)

    def _operation(self, value: Value) -> Text:
        """Text of an operation: an infix operator, a conversion, a selection or a call of a function."""
        name, kind, arguments = value.operation, value.kind, value.arguments
        texts = [self._argument(value, argument) for argument in arguments]
        if name == "select":
            condition, yes, no = texts
            return f"{_bound(condition, _CHOICE + 1)} ? {_bound(yes, _CHOICE + 1)} : {_bound(no, _CHOICE)}", _CHOICE
        if name in _OF_INTEGERS and kind is Kind.INTEGER:
            return f"({_OF_INTEGERS[name].format(*(_bound(text, ATOM) for text in texts))})", ATOM
        if name in _BITWISE and kind is Kind.INTEGER:
            return f"{_bound(texts[0], ATOM)} {_BITWISE[name]} {_bound(texts[1], ATOM)}", _OR
        if name in _INFIX:
            operator, strength = _INFIX[name]
            least = strength if strength >= _SUM else _SUM  # compilers warn about mixed comparisons, && and ||
            return f"{_bound(texts[0], least)} {operator} {_bound(texts[1], max(least, strength + 1))}", strength
        if name in ("neg", "not"):
            return f"{'-' if name == 'neg' else '!'}{_bound(texts[0], ATOM)}", PREFIX
        if name in ("real", "integer", "boolean"):
            return self._language(value).conversion(_bound(texts[0], ATOM), arguments[0].kind, kind), _COMPARISON
        if name in ("max", "min") and arguments[1].operation == "constant":
            texts.reverse()  # C tests whether the first is NAN
        language = self._language(value)
        function = language.functions[name]
        if function in language.helpers:
            self.helpers.add(language.helpers[function])
        return f"{function}({', '.join(text for text, _ in texts)})", ATOM

    def _argument(self, value: Value, argument: Value) -> Text:
        """Text of an argument in the precision of an operation."""
        if argument.operation == "constant":
            return self._literal(argument, self._language(value))
        text = self._text(argument)
        wide = self._is_wide(argument) and argument.kind is Kind.REAL
        if wide and not self._is_wide(value) and not all(map(self._is_wide, value.arguments)):
            return self.language.conversion(_bound(text, ATOM), Kind.REAL, Kind.REAL), PREFIX
        return text

    def new_name(self, letter: str, uniform: bool = True) -> str:
        """A new name, of a value that may be uniform over lanes."""
        self._names[letter] += 1
        return f"{letter}{self._names[letter]}"

    def _count(self, scope: Scope) -> None:
        """Count the uses of each value; use in another scope or a loop counts twice, as it requires a name."""
        for statement in scope.statements:
            if isinstance(statement, ForLoop):
                for variable in statement.carried:
                    if id(variable) in self._needed:
                        self._use([variable.initial] * 2, scope)
                        self._use([variable.following] * 2, statement.scope)
                for array in statement.arrays:
                    if id(array) in self._needed:
                        self._use(array.elements, statement.scope)
                self._use([statement.row] * 2, statement.scope)
                self._count(statement.scope)
            elif isinstance(statement, Branch):
                if id(statement) in self._needed:
                    self._use([statement.condition], scope)
                for inside, values in zip(statement.scopes, statement.values, strict=True):
                    for value in statement.chosen:
                        if id(value) in self._needed:
                            self._use([values[value.data[1]]] * 2, inside)
                    self._count(inside)
            elif id(statement) in self._needed:
                values = statement.elements if isinstance(statement, StoredArray) else statement.arguments
                self._use(values, statement.scope if isinstance(statement, Value) else scope)

    def _use(self, values: Sequence[Value], scope: Scope) -> None:
        """Count uses of values in a scope."""
        for value in values:
            self._uses[id(value)] += 1 if value.scope is scope else 2
            if value.scope is not scope:
                self.shared.add(id(value))


def inputs_of(scope: Scope) -> list[Value]:
    """Inputs of a scope."""
    values = (statement for statement in scope.statements if isinstance(statement, Value))
    return [value for value in values if value.operation == "input"]


def _bound(text: Text, least: int) -> str:
    """Text, in parentheses if the precedence of its outermost operator is lower than given."""
    return text[0] if text[1] >= least else f"({text[0]})"
