"""What the documentation shows is what happens; docs/tour.md is run as a doctest."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import matplotlib
import pytest

import mckibben as mk
from mckibben.cli import app

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_readme_is_short_and_its_python_gives_a_figure(monkeypatch, tmp_path):
    matplotlib.use("Agg")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    assert len(README.splitlines()) < 120
    code = re.search(r"```python\n(.*?)```", README, re.DOTALL)[1]
    assert len([line for line in code.splitlines() if line]) <= 5
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["fit"].rmse == pytest.approx(1.446, abs=5e-3)
    assert (tmp_path / "run.png").stat().st_size > 10_000


OTHER_OPTIONS = {"--extension", "--from", "--help-all", "--install-completion", "--only"}  # of all; uvx; benchmarks


@pytest.mark.slow
def test_the_commands_and_options_that_the_documentation_names_exist(cli):
    text = README + "".join(p.read_text(encoding="utf-8") for p in sorted((ROOT / "docs").glob("*.md")))
    named = {name for name in re.findall(r"\bmckibben ([a-z]+)", text) if name not in ("as", "import", "answers")}
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
    options: set[str] = set()
    for command in sorted(single | nested):
        help_text = cli(*command.split(), "--help-all").out
        for option in re.findall(rf"mckibben {command} [^`\n]*?(--[a-z-]+)", text):
            assert option in help_text, (command, option)
        options |= set(re.findall(r"--[a-z-]+", help_text))
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)) <= options | OTHER_OPTIONS


PAGES = [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md"]
GALLERY = sorted((ROOT / "examples" / "gallery").glob("*.py"))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_the_files_and_names_that_it_mentions_exist(page):
    text = page.read_text(encoding="utf-8")
    for path in re.findall(r"`((?:tests|examples|docs)/[\w/.-]+)`", text):
        assert (ROOT / path).exists(), path
    for name in re.findall(r"\bmk\.([A-Za-z_]+)", text):
        assert hasattr(mk, name), name


SKETCHES = [
    (page, block)
    for page in PAGES[:-1]
    for block in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    if ">>>" not in block  # those are run as doctests
]


@pytest.mark.parametrize(("page", "code"), SKETCHES, ids=lambda one: getattr(one, "stem", ""))
def test_python_that_needs_other_data_calls_what_exists_with_arguments_that_it_takes(page, code):
    """Its imports are run, and the arguments of what it imports are bound."""
    tree, names = ast.parse(code), {}
    imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    exec(compile(ast.Module(imports, []), page.name, "exec"), names)
    called = [one for one in ast.walk(tree) if isinstance(one, ast.Call) and isinstance(one.func, ast.Name)]
    assert called
    for call in called:
        given = {one.arg: None for one in call.keywords}
        signature = inspect.signature(names[call.func.id])
        left_out = any(isinstance(one, ast.Constant) and one.value is ... for one in call.args)
        (signature.bind_partial if left_out else signature.bind)(*call.args, **given)


def test_every_page_is_in_the_index_and_in_the_site_once():
    docs = ROOT / "docs"
    pages = {str(page.relative_to(docs).with_suffix("")) for page in docs.rglob("*.md")} - {"index"}
    index = (docs / "index.md").read_text("utf-8")
    toctrees = re.findall(r"```\{toctree\}\n(.*?)```", index, re.DOTALL)
    listed = [line for block in toctrees for line in block.splitlines() if line and not line.startswith(":")]
    assert sorted(listed) == sorted([*pages, "gallery/index"])
    assert pages <= set(re.findall(r"\]\(([\w/-]+)\.md", index))


def test_pages_are_few_and_short_and_each_names_the_next():
    pages = sorted((ROOT / "docs").glob("*.md"))
    texts = {page.stem: re.sub("<!--.*?-->", "", page.read_text("utf-8"), flags=re.DOTALL) for page in pages}
    words = {name: len(text.split()) for name, text in texts.items()}
    assert len(words) <= 32 and sum(words.values()) <= 40_000
    long = {name: number for name, number in words.items() if number > 1_200}
    assert long.keys() <= {"extending"}  # code of one class of each common kind
    for page in pages:
        steps = re.findall(r"^Next: .*\]\([\w./#-]+\)", page.read_text("utf-8"), re.MULTILINE)
        assert len(steps) == 1, page.name


def test_the_reference_has_every_public_name():
    text = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    blocks = re.findall(r"currentmodule:: (\S+)(.*?)```", text, re.DOTALL)
    found: dict[str, set[str]] = {}
    for module, block in blocks:
        found.setdefault(module, set()).update(re.findall(r"^   (\w+)$", block, re.MULTILINE))
    assert found["mckibben"] == set(mk.__all__) - {"catalog", "joint", "robot", "report", "units"}
    assert found["mckibben.robot"] == set(mk.robot.__all__)
    assert found["mckibben.report"] == set(mk.report.__all__)
    assert found["mckibben.catalog"] == set(mk.catalog.__all__)


@pytest.mark.parametrize("script", GALLERY, ids=lambda p: p.stem)
def test_an_example_of_the_gallery_has_a_title_a_figure_and_only_public_names(script):
    tree = ast.parse(script.read_text(encoding="utf-8"))
    title, line = (ast.get_docstring(tree) or "").splitlines()[:2]
    assert len(title) == len(line) and set(line) == {"="}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mckibben"):
            module = importlib.import_module(node.module)
            for alias in node.names:
                assert hasattr(module, alias.name), alias.name
                assert node.module == "mckibben.units" or alias.name in module.__all__, alias.name
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_") or node.attr.endswith("__"), node.attr
            if isinstance(node.value, ast.Name) and node.value.id == "mk":
                assert node.attr in mk.__all__, node.attr
            if isinstance(node.value, ast.Attribute) and node.value.attr in ("report", "catalog"):
                assert node.attr in getattr(mk, node.value.attr).__all__, node.attr
    stored = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    assert any(name.startswith("figure") for name in stored)
