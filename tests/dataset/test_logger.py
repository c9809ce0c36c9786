"""Displacements with sign and zero, several files of one test, slow loops, and the recipe for the next file."""

import numpy as np
import pytest

from mckibben.dataset import Recipe, Recording, read_dataset, read_recording
from mckibben.errors import DatasetError, McKibbenWarning, RangeError, ScenarioError
from mckibben.units import bar

LENGTH = 0.3
CONTRACTION = np.concatenate([np.linspace(0, 0.2, 9), np.linspace(0.18, 0, 9)])
HEADER = "Zeit [s];Druck [bar];Weg [mm];Kraft [N]\n"


def rows(pressure: float, displacement: np.ndarray, contraction: np.ndarray = CONTRACTION, more: float = 0.0) -> str:
    force = 40 + more + pressure * (100 - 300 * contraction)
    values = zip(np.arange(len(contraction)), displacement * 1e3, force, strict=True)
    return "".join(f"{t};{pressure:.2f};{d:.6f};{f:.4f}\n".replace(".", ",") for t, d, f in values)


@pytest.mark.parametrize(
    ("sign", "zero", "given"),
    [
        (-1, LENGTH, {"displacement": "shortening"}),
        (1, LENGTH, {"displacement": "lengthening"}),
        (1, 0.27, {"displacement": "lengthening", "zero_length": 0.27}),
        (-1, 0.31, {"displacement": "shortening", "zero_length": 0.31}),
    ],
)
def test_displacements_with_sign_and_zero_give_contractions(tmp_path, sign, zero, given):
    moved = sign * (LENGTH * (1 - CONTRACTION) - zero)
    (tmp_path / "rig.csv").write_text(HEADER + rows(2, moved) + rows(3, moved))
    data = read_dataset(tmp_path / "rig.csv", initial_length=LENGTH, **given)
    np.testing.assert_allclose(data.contraction, np.tile(CONTRACTION, 2), atol=1e-8)
    read = next(line for line in data.table.attrs["columns_read"].splitlines() if line.startswith("Weg"))
    assert given["displacement"] in read and f"{zero * 1e3:g} mm" in read


def test_the_sign_of_a_displacement_is_asked_for(tmp_path):
    (tmp_path / "rig.csv").write_text(HEADER + rows(2, LENGTH * CONTRACTION))
    with pytest.raises(DatasetError) as caught:
        read_dataset(tmp_path / "rig.csv", initial_length=LENGTH)
    (problem,) = caught.value.problems
    assert problem.field == "Weg [mm]" and "displacement=" in problem.remedy and "--displacement" in problem.remedy
    with pytest.raises(DatasetError) as caught:
        read_dataset(tmp_path / "rig.csv", displacement="shortening")
    assert [problem.field for problem in caught.value.problems] == ["initial_length"]
    with pytest.raises(RangeError) as wrong:
        read_dataset(tmp_path / "rig.csv", displacement="up")  # type: ignore[arg-type]  # refused at run time
    assert wrong.value.field == "displacement"


def test_a_displacement_next_to_a_contraction_is_not_read(tmp_path):
    (tmp_path / "rig.csv").write_text("pressure_bar,displacement_mm,contraction_percent,force_N\n1,3,0,80\n1,9,5,40\n")
    data = read_dataset(tmp_path / "rig.csv")
    assert data.contraction.tolist() == [0, 0.05]
    assert data.table.attrs["ignored_columns"] == "displacement_mm"


def test_a_recording_has_displacements_too(tmp_path):
    (tmp_path / "rig.csv").write_text(HEADER + rows(2, LENGTH * CONTRACTION))
    found = read_recording(tmp_path / "rig.csv", initial_length=LENGTH, displacement="shortening")
    np.testing.assert_allclose(found.table["contraction"], CONTRACTION, atol=1e-8)


def loop_files(folder, *parts: tuple[float, np.ndarray]):
    paths = []
    for number, (pressure, contraction) in enumerate(parts):
        paths.append(folder / f"{number}.csv")
        paths[-1].write_text(HEADER + rows(pressure, LENGTH * contraction, contraction, 0.1 * number))
    return paths


def test_several_files_are_one_test(tmp_path):
    paths = loop_files(tmp_path, (2, CONTRACTION), (3, CONTRACTION), (3, CONTRACTION))
    data = read_dataset(paths, initial_length=LENGTH, displacement="shortening")
    assert len(data) == 3 * len(CONTRACTION) and data.pressures.tolist() == [2 * bar, 3 * bar]
    assert data.table["direction"].to_numpy()[:18].tolist() == 9 * ["unloading"] + 9 * ["loading"]
    repeat = data.table["repeat"].to_numpy().reshape(3, -1)
    assert [set(each.tolist()) for each in repeat] == [{0}, {0}, {1}]
    assert data.table.attrs["source"] == "0.csv, 1.csv, 2.csv"
    assert (np.diff(data.table["time"]) > 0).all()  # the clock of each file starts at 0


def test_files_of_one_stroke_each_have_a_direction(tmp_path):
    rising, falling = np.linspace(0, 0.2, 9), np.linspace(0.2, 0, 9)
    paths = loop_files(tmp_path, (2, rising), (2, rising), (2, falling), (2, falling))
    data = read_dataset(paths, initial_length=LENGTH, displacement="shortening")
    assert data.table["direction"].to_numpy().reshape(4, -1).tolist() == 2 * [9 * ["unloading"]] + 2 * [9 * ["loading"]]
    assert data.table["repeat"].to_numpy()[::9].tolist() == [0, 1, 0, 1]


def test_recordings_of_several_files_end_their_plateaus(tmp_path):
    paths = []
    for number in (0, 1):
        lines = [f"{0.1 * i:.1f},2,10,80\n" for i in range(30)]
        paths.append(tmp_path / f"{number}.csv")
        paths[-1].write_text("time_s,pressure_bar,contraction_percent,force_N\n" + "".join(lines))
    found = read_recording(paths).plateaus()
    assert len(found.dataset) == 2


def test_files_that_contradict_each_other_are_refused(tmp_path):
    for name, length in (("a.csv", "200 mm"), ("b.csv", "300 mm")):
        text = f"# initial_length: {length}\npressure_bar,length_mm,force_N\n1,190,80\n1,180,40\n"
        (tmp_path / name).write_text(text)
    with pytest.raises(DatasetError) as caught:
        read_dataset([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert [problem.field for problem in caught.value.problems] == ["initial_length"]
    with pytest.raises(RangeError):
        read_dataset([])


def test_columns_that_only_some_files_have_are_left_out_with_a_warning(tmp_path):
    (tmp_path / "a.csv").write_text("pressure_bar,contraction_percent,force_N,repeat\n1,0,80,1\n1,5,40,1\n")
    (tmp_path / "b.csv").write_text("pressure_bar,contraction_percent,force_N\n2,0,160\n2,5,90\n")
    with pytest.warns(McKibbenWarning, match="repeat"):
        data = read_dataset([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert "repeat" not in data.table and len(data) == 4


def test_a_slow_loop_is_told_from_plateaus():
    time = np.arange(0, 200, 0.1)
    contraction = 0.1 + 0.1 * np.sin(2 * np.pi * time / 100)
    loop = Recording.of(time=time, pressure=2e5 + 0 * time, force=100 - 300 * contraction, contraction=contraction)
    notes = loop.plateaus(contraction_tolerance=0.002).notes
    assert any("mckibben identify" in note for note in notes)
    with pytest.raises(RangeError) as caught:
        loop.plateaus(contraction_tolerance=1e-5)
    assert "mckibben identify" in caught.value.remedy
    steps = Recording.of(time=time, pressure=2e5 + 0 * time, force=80 + 0 * time, contraction=0.01 * (time // 20))
    with pytest.warns(McKibbenWarning, match="contractions"):  # of this muscle the force is the same everywhere
        notes = steps.plateaus().notes
    assert not any("mckibben identify" in note for note in notes)


def test_a_recipe_reads_the_next_file(tmp_path):
    recipe = Recipe(displacement="shortening", initial_length=LENGTH, force_sign=-1, slack_force=2.0)
    recipe.to_yaml(tmp_path / "recipe.yaml")
    assert Recipe.read(tmp_path / "recipe.yaml") == recipe
    lines = rows(2, LENGTH * CONTRACTION).splitlines()
    (tmp_path / "next.csv").write_text(HEADER + "\n".join(";-".join(line.rsplit(";", 1)) for line in lines))
    data = Recipe.read(tmp_path / "recipe.yaml").dataset(tmp_path / "next.csv")
    assert data.force.min() > 0 and data.table.attrs["slack_force"] == 2.0
    np.testing.assert_allclose(data.contraction, CONTRACTION, atol=1e-8)


def test_a_recipe_with_mistakes_names_them_all(tmp_path):
    (tmp_path / "recipe.yaml").write_text("initial_length: 300\ndisplacement: up\nforce_sing: -1\n")
    with pytest.raises(ScenarioError) as caught:
        Recipe.read(tmp_path / "recipe.yaml")
    assert [problem.field for problem in caught.value.problems] == ["initial_length", "displacement", "force_sing"]


def slack_table(end: float) -> str:
    noise = np.random.default_rng(round(end)).normal(0, 0.02, 81)
    lines = [
        f"{p},{c:.2f},{max(100 * p - 20 * c, 0) + 3 + e:.3f}\n"
        for p in (1, 2)
        for c, e in zip(np.linspace(0, end, 81), noise, strict=True)
    ]
    return "pressure_bar,contraction_percent,force_N\n" + "".join(lines)


def test_a_slack_force_known_for_some_files_only_is_an_error(tmp_path):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    paths[0].write_text("# slack_force: 1 N\n" + slack_table(20))
    paths[1].write_text(slack_table(21))
    with pytest.raises(DatasetError) as caught:
        read_dataset(paths)
    (problem,) = caught.value.problems
    assert problem.field == "slack_force" and "--slack-force" in problem.remedy
    assert read_dataset(paths[1]).force.min() < 1  # the offset of 3 N is subtracted
    assert read_dataset(paths, slack_force=4.0).force.min() > 2
    timed = [line if "," not in line else f"{i}," + line for i, line in enumerate(slack_table(20).splitlines())]
    timed[0] = "time_s," + timed[0].partition(",")[2]
    paths[0].write_text("# slack_force: 1 N\n" + "\n".join(timed))
    paths[1].write_text("\n".join(timed))
    with pytest.raises(DatasetError) as caught:
        read_recording(paths)
    assert [problem.field for problem in caught.value.problems] == ["slack_force"]
    assert len(read_recording(paths, slack_force=1.0)) == 324


def test_repeats_of_different_files_are_distinct(tmp_path):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path in paths:
        rows = [f"2,{c},{100 - 3 * c},loading,{k}\n" for k in (0, 1) for c in (10, 5, 0)]
        path.write_text("pressure_bar,contraction_percent,force_N,direction,repeat\n" + "".join(rows))
    repeat = read_dataset(paths).table["repeat"].to_numpy()
    assert repeat.reshape(-1, 3).tolist() == [[0] * 3, [1] * 3, [2] * 3, [3] * 3]


def test_a_recording_whose_clock_goes_on_is_another_plateau(tmp_path):
    paths = []
    for number in (0, 1):
        lines = [f"{0.1 * i:.1f},2,10,80\n" for i in range(30 * number, 30 * number + 30)]
        paths.append(tmp_path / f"{number}.csv")
        paths[-1].write_text("time_s,pressure_bar,contraction_percent,force_N\n" + "".join(lines))
    assert len(read_recording(paths).plateaus().dataset) == 2


def test_a_displacement_next_to_a_length_is_compared(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("pressure_bar,length_mm,Weg [mm],force_N\n1,300,0,80\n1,285,15,40\n")
    given = {"columns": {"Weg [mm]": "displacement_mm"}, "initial_length": 0.3}
    assert read_dataset(path, displacement="shortening", **given).contraction.tolist() == pytest.approx([0, 0.05])
    with pytest.raises(DatasetError) as caught:
        read_dataset(path, displacement="lengthening", **given)
    (problem,) = caught.value.problems
    assert (problem.field, problem.line) == ("Weg [mm]", 3)


def test_options_of_a_displacement_that_is_not_read_cause_a_warning(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("pressure_bar,length_mm,force_N\n1,300,80\n1,285,40\n")
    with pytest.warns(McKibbenWarning, match="zero_length"):
        read_dataset(path, initial_length=0.3, zero_length=0.3)


def test_a_given_contraction_leaves_a_displacement_unread(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("time_s,pressure_bar,displacement_mm,force_N\n0,1,3,80\n1,1,3,40\n")
    found = read_recording(path, contraction=0.05)
    assert found.table["contraction"].to_numpy().tolist() == [0.05, 0.05]
    assert found.table.attrs["ignored_columns"] == "displacement_mm"


def test_an_impossible_displacement_names_its_options(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("pressure_bar,displacement_mm,force_N\n1,0,80\n1,900,40\n")
    with pytest.raises(DatasetError) as caught:
        read_dataset(path, initial_length=0.3, displacement="lengthening")
    assert all(name in caught.value.problems[0].remedy for name in ("displacement", "zero_length"))
