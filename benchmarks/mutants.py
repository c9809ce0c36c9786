"""Mutants of the source: small random faults that some test has to notice.

``python benchmarks/mutants.py --count 100 --seed 1`` changes one comparison, operator, number, truth value or statement
at a time in a copy of the working tree and runs tests there: a few that execute its line, all tests in the files of
the nearest ones, then all of its package. It prints each that survives with its file and line. Equal seeds make equal
mutants. The folder ``build/mutants`` has the copy, which tests execute which lines (recorded once with ``coverage``)
and the results; the same command continues an interrupted run and tries survivors again with the tests of now. After a
change of the source, remove the folder.
``make mutants`` runs some.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import multiprocessing
import os
import py_compile
import random
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

if TYPE_CHECKING:
    from coverage import CoverageData

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "build" / "mutants"
PACKAGES = "numerics muscle joint actuator plant control simulation identification storage rig"
SECONDS = 600  # of the processor, and three times as long by the clock, for a run of tests
FIRST = 8  # tests that execute a mutant's line, which are run by themselves
FILES = 8  # of tests that execute it, which are run completely if the first tests do not notice it
SWAPPED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
}  # fmt: skip


class Mutant(NamedTuple):
    """One replacement of a part of a file."""

    path: Path
    line: int
    span: tuple[int, int]  # bytes
    before: str
    after: str


def replacement(node: ast.AST) -> str | None:
    """Source of a node's faulty variant; None where it has none."""
    match node:
        case ast.Compare(left, [operator], [right]) if type(operator) in SWAPPED:
            return ast.unparse(ast.Compare(left, [SWAPPED[type(operator)]()], [right]))
        case ast.BinOp(left, operator, right) if type(operator) in SWAPPED and not isinstance(left, ast.JoinedStr):
            return f"({ast.unparse(ast.BinOp(left, SWAPPED[type(operator)](), right))})"
        case ast.BoolOp(operator, values):
            return f"({ast.unparse(ast.BoolOp(SWAPPED[type(operator)](), values))})"
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            return f"({ast.unparse(operand)})"
        case ast.Constant(bool() as value):
            return str(not value)
        case ast.Constant(int() | float() as value):
            return repr(value * 2 or 1)
        case ast.Expr(ast.Call()) | ast.AugAssign() | ast.Raise() | ast.Break() | ast.Continue():
            return "pass"
    return None


def nodes(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes that a program computes with: no annotations, no texts of messages, and no `strict` of `zip`."""
    yield node
    for name, value in ast.iter_fields(node):
        strict = isinstance(node, ast.keyword) and node.arg == "strict"  # an assertion about our own code
        if name in ("annotation", "returns", "exc") or isinstance(node, ast.JoinedStr) or strict:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from nodes(child)


def mutants(path: Path, root: Path) -> list[Mutant]:
    """All mutants of a file."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for node in nodes(ast.parse(source)):
        if (after := replacement(node)) is not None:
            begin = starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
            end = starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
            before = source[begin:end].decode()
            found.append(Mutant(path.relative_to(root), node.lineno, (begin, end), before, after))  # type: ignore
    return found


def _run(copy: Path, arguments: list[str], names: list[str] | None) -> None:
    """Run tests in the copy, in a process that imported JAX and others already."""

    class Chosen:
        def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
            items[:] = [item for item in items if names is None or item.nodeid in names]

    os.setpgid(0, 0)
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    os.chdir(copy)
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    sys.path.insert(0, str(copy / "src"))
    sys.dont_write_bytecode = True  # two mutants of a file may have one size and second
    os.environ |= {"PYTHONPATH": str(copy / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    always = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow"]
    os._exit(pytest.main([*always, *arguments], [Chosen()]))


def passes(copy: Path, arguments: list[str], names: list[str] | None = None) -> bool:
    """Whether tests pass in the copy, or there are none; `names` chooses some of those that the arguments name."""
    process = multiprocessing.get_context("fork").Process(target=_run, args=(copy, arguments, names))
    process.start()
    process.join(3 * SECONDS)
    if process.is_alive():
        print(f"stopped after {3 * SECONDS} s", file=sys.stderr)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)  # type: ignore  # what the tests started, too
    process.join()
    return process.exitcode in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)


def record(copy: Path, packages: list[str]) -> CoverageData:
    """Which tests of packages execute which lines; they have to pass."""
    from coverage import CoverageData

    file = FOLDER / "coverage"
    if not file.exists():
        settings = FOLDER / "settings.ini"  # coverage removes all files of the name coverage.*
        sources = "".join(f"    {copy}/src/mckibben/{package}/*\n" for package in packages)
        settings.write_text(f"[run]\ncore = ctrace\ndata_file = {file}\ninclude =\n{sources}")
        options = ["-n", "2", "--dist", "loadfile", "--cov", f"--cov-config={settings}", "--cov-context=test"]
        if not passes(copy, [*options, "--cov-report=", *(name for one in packages for name in tests_of(one))]):
            file.unlink(missing_ok=True)
            sys.exit("the tests fail without a mutant")
    data = CoverageData(str(file))
    data.read()
    if data.measured_contexts() <= {""}:
        file.unlink()
        sys.exit("no test was recorded")
    return data


def tests_of(package: str) -> list[str]:
    """Its folders of tests."""
    return [f"tests/{package}", f"src/mckibben/{package}"]


def executing(data: CoverageData, copy: Path, mutant: Mutant) -> list[str]:
    """Tests that execute a mutant's line, then those that execute its file: those that stand nearest first."""
    lines = data.contexts_by_lineno(str(copy / mutant.path))
    recorded = max((line for line in lines if line <= mutant.line), default=0)  # the line where an expression begins
    near = f"/{mutant.path.parts[2]}/", f"/test_{mutant.path.stem}.py"
    found: dict[str, None] = {}
    for contexts in (lines.get(recorded, []), [one for each in lines.values() for one in each]):
        names = sorted({context.partition("|")[0] for context in contexts} - {""})
        random.Random(0).shuffle(names)
        found |= dict.fromkeys(sorted(names, key=lambda name: [part in name for part in near], reverse=True))
    return list(found)


def _files(names: list[str]) -> list[str]:
    return list(dict.fromkeys(name.partition("::")[0] for name in names))


def survives(copy: Path, mutant: Mutant, names: list[str], folders: list[str]) -> bool:
    """Whether neither the tests that execute it nor those of folders notice a mutant; the copy is as before afterwards.

    Complete files, too: a compiled function is traced by the first test that calls it, and others reuse it.
    """
    target = copy / mutant.path
    source = target.read_bytes()
    runs = [(_files(names[:FIRST]), names[:FIRST]), (_files(names)[:FILES], None)] if names else []
    try:
        target.write_bytes(source[: mutant.span[0]] + mutant.after.encode() + source[mutant.span[1] :])
        return all(passes(copy, *run) for run in [*runs, (folders, None)])
    finally:
        target.write_bytes(source)


def main() -> None:
    """Try mutants, and print those that survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--packages", default=PACKAGES, help="names between spaces")
    given = parser.parse_args()
    chance, packages = random.Random(given.seed), given.packages.split()
    copy, results = FOLDER / "copy", FOLDER / "results.txt"
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # the file of a mutant is put back
    for name in subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True).split("\0")[:-1]:
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, copy / name)
    compileall.compile_dir(copy / "src", quiet=1, invalidation_mode=py_compile.PycInvalidationMode.CHECKED_HASH)
    files = {one: sorted((copy / "src" / "mckibben" / one).rglob("*.py")) for one in packages}
    every = {one: [mutant for path in paths for mutant in mutants(path, copy)] for one, paths in files.items()}
    for found in every.values():
        chance.shuffle(found)
    chosen = [every[packages[number % len(packages)]][number // len(packages)] for number in range(given.count)]
    data = record(copy, packages)
    known = dict(reversed(line.split(" ", 1)) for line in results.read_text().splitlines()) if results.exists() else {}
    for number, mutant in enumerate(chosen):
        name = f"{mutant.path}:{mutant.line} {mutant.span[0]}: {mutant.before!r} -> {mutant.after!r}"
        if known.get(name) != "noticed":
            alive = survives(copy, mutant, executing(data, copy, mutant), tests_of(mutant.path.parts[2]))
            known[name] = "SURVIVES" if alive else "noticed"
            with results.open("a") as file:
                file.write(f"{known[name]} {name}\n")
        print(f"{number + 1:4} {known[name]:8} {name}", flush=True)
    print(f"{len(known)} mutants, {list(known.values()).count('SURVIVES')} survive")
    sys.exit("SURVIVES" in known.values())


if __name__ == "__main__":
    del sys.path[0]  # this folder, in which a script has the name of the package coverage
    for heavy in ("equinox", "hypothesis", "scipy.optimize", "xarray"):  # once, and not in each run of tests
        __import__(heavy)
    main()
