"""Mutants of the source: small random faults that some test has to notice.

``python benchmarks/mutants.py --count 100 --seed 1`` changes one comparison, operator, number, truth value or statement
at a time in a copy of the working tree, runs the tests of its package there, then those of ``make test``, and prints
each survivor with its file and line. Equal seeds make equal mutants. ``make mutants`` runs some.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGES = "numerics muscle joint plant control simulation identification storage rig"
SECONDS = 900  # of a run of tests; a mutant that takes longer is noticed
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
    """The nodes that a program computes with: no annotations, and no texts of messages."""
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "exc") or isinstance(node, ast.JoinedStr):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from nodes(child)


def mutants(path: Path) -> list[Mutant]:
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
            found.append(Mutant(path.relative_to(ROOT), node.lineno, (begin, end), before, after))  # type: ignore
    return found


def passes(copy: Path, tests: list[str]) -> bool:
    """Whether tests pass in the copy."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *tests]
    environment = os.environ | {"PYTHONPATH": str(copy / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.setdefault("JAX_COMPILATION_CACHE_DIR", str(copy / "build" / "jax-cache"))
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=SECONDS)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def survives(copy: Path, mutant: Mutant, *, everything: bool) -> bool:
    """Whether no test notices a mutant; the copy is as before afterwards."""
    target, package = copy / mutant.path, mutant.path.parts[2]
    source = target.read_bytes()
    own = copy / "tests" / package / f"test_{mutant.path.stem}.py"
    stages = [[str(own)]] if own.exists() else []
    stages += [[f"tests/{package}", f"src/mckibben/{package}"]]
    stages += [["-n", "2", "--dist", "loadfile"]] if everything else []
    try:
        target.write_bytes(source[: mutant.span[0]] + mutant.after.encode() + source[mutant.span[1] :])
        return all(passes(copy, tests) for tests in stages)
    finally:
        target.write_bytes(source)


def main() -> None:
    """Try mutants, and print those that survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--packages", default=PACKAGES, help="names between spaces")
    parser.add_argument("--own-only", action="store_true", help="leave out the tests of other packages")
    given = parser.parse_args()
    chance, packages = random.Random(given.seed), given.packages.split()
    files = {one: sorted((ROOT / "src" / "mckibben" / one).rglob("*.py")) for one in packages}
    every = {one: [mutant for path in paths for mutant in mutants(path)] for one, paths in files.items()}
    found = [chance.choice(every[packages[number % len(packages)]]) for number in range(given.count)]
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, "copy")
        for name in subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True).split("\0")[:-1]:
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
        for package in packages:
            if not passes(copy, [f"tests/{package}"]):
                sys.exit(f"the tests of {package} fail without a mutant")
        for mutant in found:
            alive = survives(copy, mutant, everything=not given.own_only)
            survivors += alive
            what = f"{mutant.before!r} -> {mutant.after!r}"
            print(f"{'SURVIVES' if alive else 'noticed '} {mutant.path}:{mutant.line}: {what}", flush=True)
    print(f"{len(found)} mutants, {survivors} survive")
    sys.exit(bool(survivors))


if __name__ == "__main__":
    main()
