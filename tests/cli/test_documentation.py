"""What the documentation shows is what happens; docs/tour.md is run as a doctest."""

import re
from pathlib import Path

import matplotlib
import pytest

import mckibben as mk
from mckibben.cli import app
from mckibben.units import deg

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_of_the_readme_runs_and_gives_the_numbers_in_its_comments(monkeypatch, tmp_path, capsys):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    code = re.search(r"```python\n(.*?)```", README, re.DOTALL)[1]
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert "RMSE 1.07 N" in capsys.readouterr().out
    assert names["fit"].rmse == pytest.approx(1.07, abs=5e-3)
    assert names["fit"].estimates["decay"] / 100 == pytest.approx(0.400, abs=5e-4)
    low, high = names["knee"].attainable_stiffness(0.0, -names["load"].gravity_torque(0.0))
    assert (float(low), float(high)) == pytest.approx((10.0, 19.5), abs=0.05)
    assert names["result"].metrics["angle_rmse"] / deg == pytest.approx(1.48, abs=5e-3)
    assert (tmp_path / "run.png").stat().st_size > 10_000


def test_the_commands_and_options_that_the_documentation_names_exist(cli):
    text = README + "".join(p.read_text(encoding="utf-8") for p in sorted((ROOT / "docs").glob("*.md")))
    named = {name for name in re.findall(r"\bmckibben ([a-z]+)", text) if name not in ("as", "import")}
    single = {command.name or command.callback.__name__ for command in app.registered_commands}
    groups = {group.typer_instance.info.name: group.typer_instance for group in app.registered_groups}
    assert {"identify", "validate", "simulate", "reproduce"} <= named <= single | groups.keys()
    nested = {
        f"{name} {command.name or command.callback.__name__}"
        for name, group in groups.items()
        for command in group.registered_commands
    }
    for name in groups:
        assert {f"{name} {word}" for word in re.findall(rf"\bmckibben {name} ([a-z]+)", text)} <= nested
    for command in sorted(single | nested):
        help_text = cli(*command.split(), "--help").out
        for option in re.findall(rf"mckibben {command} [^`\n]*?(--[a-z-]+)", text):
            assert option in help_text, (command, option)


@pytest.mark.parametrize("page", [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md"], ids=lambda p: p.name)
def test_the_files_and_links_that_it_names_exist(page):
    text = page.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (page.parent / link).exists(), link
    for path in re.findall(r"`((?:tests|examples|docs)/[\w/.-]+)`", text):
        assert (ROOT / path).exists(), path
    for name in re.findall(r"\bmk\.([A-Za-z_]+)", text):
        assert hasattr(mk, name), name
