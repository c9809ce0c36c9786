"""Random bits of JAX's keys (Threefry-2x32, Salmon et al. 2011) as 64-bit integer operations on 32-bit words."""

from __future__ import annotations

import jax

from mckibben.codegen.graph import Graph, Kind, Value

MASK = 0xFFFFFFFF
_PARITY = 0x1BD11BDA
_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
Pair = tuple[Value, Value]


def seed_key(graph: Graph, seed: Value) -> Pair:
    """Key of an integer seed."""
    return _shifted(graph, "shift_right", seed, 32), _masked(graph, seed)


def fold_in(graph: Graph, key: Pair, data: Value) -> Pair:
    """Key derived from a key and a word."""
    return threefry(graph, key, (_integer(graph, 0), data))


def random_bits(graph: Graph, key: Pair, index: int, width: int) -> Value:
    """Bits at an index of an array drawn from a key."""
    high, low = threefry(graph, key, (_integer(graph, index >> 32), _integer(graph, index & MASK)))
    if width == 64:
        return _operation(graph, "or", _shifted(graph, "shift_left", high, 32), low)
    return _masked(graph, _operation(graph, "xor", high, low))


def threefry(graph: Graph, key: Pair, counts: Pair) -> Pair:
    """Two words from a key and a counter."""
    parity = _operation(graph, "xor", _operation(graph, "xor", *key), _integer(graph, _PARITY))
    keys = (*key, parity)
    x, y = (_sum(graph, count, word) for count, word in zip(counts, key, strict=True))
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x = _sum(graph, x, y)
            left = _masked(graph, _shifted(graph, "shift_left", y, rotation))
            y = _operation(graph, "or", left, _shifted(graph, "shift_right", y, 32 - rotation))
            y = _operation(graph, "xor", x, y)
        x = _sum(graph, x, keys[(group + 1) % 3])
        y = _sum(graph, _sum(graph, y, keys[(group + 2) % 3]), _integer(graph, group + 1))
    return x, y


def is_supported() -> bool:
    """Whether JAX draws its bits in the same way as `random_bits`."""
    return bool(jax.config.jax_threefry_partitionable)  # type: ignore[attr-defined]


def _integer(graph: Graph, number: int) -> Value:
    return graph.constant(number, Kind.INTEGER)


def _operation(graph: Graph, name: str, *arguments: Value) -> Value:
    return graph.operation(name, Kind.INTEGER, *arguments)


def _masked(graph: Graph, x: Value) -> Value:
    return _operation(graph, "and", x, _integer(graph, MASK))


def _sum(graph: Graph, x: Value, y: Value) -> Value:
    return _masked(graph, _operation(graph, "add", x, y))


def _shifted(graph: Graph, name: str, x: Value, places: int) -> Value:
    shifted = _operation(graph, name, x, _integer(graph, places))
    return _masked(graph, shifted) if name == "shift_right" and places == 32 else shifted
