"""Files of each kind of `benchmarks/messy.py`: none is read wrong in silence."""

import importlib
from pathlib import Path

import pytest

from mckibben.dataset import read_dataset
from mckibben.errors import DatasetError, RangeError

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
THOUSANDS = "Pressure [bar];Contraction [%];Force [N]\n2;0;1.234\n3;0;1.851\n"


@pytest.fixture
def messy(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("messy")


@pytest.mark.slow
def test_no_kind_of_file_is_read_wrong_in_silence(messy, tmp_path):
    found = {(kind, seed): messy.read(kind, seed, tmp_path) for kind in messy.KINDS for seed in range(2)}
    assert len(messy.KINDS) >= 80
    assert {key: read.text for key, read in found.items() if read.outcome == "wrong in silence"} == {}


def test_the_kinds_of_the_finding_are_right_or_asked(messy, tmp_path):
    expected = {
        "comma_and_point": "right",
        "hdf5_scale_factor": "right",
        "hdf5_scale_and_offset": "right",
        "hdf5_missing_value": "asked",
        "excel_thousands_as_text": "asked",
        "excel_hidden_rows": "wrong with a warning",
        "thousands_points_with_semicolons": "asked",
        "thousands_unquoted_before_an_empty_note": "asked",
        "decimal_comma_in_the_first_column": "asked",
        "comment_on_preprocessing_and_negative_pull": "asked",
        "minus_9999_among_pascals": "asked",
    }
    assert {kind: messy.read(kind, 0, tmp_path).outcome for kind in expected} == expected


def test_the_option_settles_ambiguous_thousands(put):
    path = put(THOUSANDS)
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (2, "Force [N]")
    assert "1234" in problem.message and "1.234" in problem.message and "--decimal" in problem.remedy
    assert read_dataset(path, decimal=",").force.tolist() == [1234, 1851]
    with pytest.raises(RangeError):
        read_dataset(path, decimal=";")
