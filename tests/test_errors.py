import pickle

import pytest

import mckibben as mk
from mckibben import errors
from mckibben.errors import DatasetError, FileError, NotInCatalogError, Problem, RangeError, UnitError, printable


def test_all_errors_are_of_one_family_and_of_the_usual_python_kind():
    family = [e for e in vars(errors).values() if isinstance(e, type) and issubclass(e, Exception)]
    for error in family:
        if issubclass(error, Warning):
            continue
        assert issubclass(error, mk.McKibbenError), error
        assert error.__doc__, error
    assert issubclass(UnitError, ValueError)
    assert issubclass(NotInCatalogError, KeyError)


@pytest.mark.parametrize(
    ("problem", "text"),
    [
        (Problem("is empty"), "is empty"),
        (Problem("is empty", line=3), "line 3: is empty"),
        (Problem("is empty", field="force_N"), "force_N: is empty"),
        (Problem("is empty", line=3, field="force_N"), "line 3, force_N: is empty"),
        (Problem("is empty", line=0), "line 0: is empty"),
        (Problem("is empty", line=3, remedy="fill it"), "line 3: is empty; fill it"),
    ],
)
def test_a_problem_says_where_what_and_what_to_do(problem, text):
    assert str(problem) == text


def test_a_file_error_lists_all_its_problems():
    error = DatasetError("rig.csv", [Problem("a", line=1), Problem("b", line=2)])
    assert str(error) == "rig.csv: 2 problems\n  line 1: a\n  line 2: b"
    assert error.source == "rig.csv"
    assert [p.line for p in error.problems] == [1, 2]


def test_a_long_list_is_cut_and_says_by_how_much():
    problems = [Problem(f"x{i}", line=i) for i in range(FileError.shown + 7)]
    lines = str(FileError("f", problems)).splitlines()
    assert lines[0] == f"f: {FileError.shown + 7} problems"
    assert len(lines) == FileError.shown + 2
    assert lines[-1] == "  ... and 7 more"
    assert len(FileError("f", problems).problems) == FileError.shown + 7


def test_a_problem_that_repeats_is_shown_once_with_its_lines():
    problems = [Problem("is empty", line=line) for line in (3, 4, 5, 9)] + [Problem("is long", line=6), Problem("x")]
    lines = str(FileError("f", problems)).splitlines()
    assert lines == ["f: 6 problems", "  lines 3-5, 9: is empty", "  line 6: is long", "  x"]


def test_a_file_error_survives_a_trip_to_another_process():
    error = DatasetError("rig.csv", [Problem("a", line=1)])
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is DatasetError
    assert str(copy) == str(error)
    assert copy.problems == error.problems


def test_a_simple_error_survives_a_trip_to_another_process():
    error = RangeError("far", value=3, lower=0.0, upper=1.0, unit="m", remedy="less")
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert (copy.value, copy.lower, copy.upper, copy.unit, copy.remedy) == (3, 0.0, 1.0, "m", "less")


@pytest.mark.parametrize("char", ["\x1b", "\r", "\x00", "\u202e", "\u200b", "\udcff"])
def test_what_a_terminal_would_obey_is_escaped(char):
    shown = printable(f"a{char}b\nü \N{GRINNING FACE}")
    assert char not in shown
    assert shown == f"a{char.encode('unicode_escape').decode()}b\nü \N{GRINNING FACE}"
    assert char not in str(RangeError(f"name {char}", remedy=char))
    assert char not in str(FileError("f.yaml", [Problem(char, field=char, remedy=char)]))


def test_messages_are_of_limited_length():
    long = "x" * 100_000
    assert len(str(RangeError(long, remedy=long))) < 2100
    assert len(str(FileError("f.yaml", [Problem(long, field=long, remedy=long)] * 100))) < 70_000
    assert RangeError(long).message == long
