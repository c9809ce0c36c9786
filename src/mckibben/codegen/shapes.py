"""Operations of a jaxpr that move the elements of arrays and compute nothing."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = Any  # an array of values


class ShapeRules:
    """A rule for each operation: its parameters, the kind and shape of the result, and the arguments."""

    def _broadcast_in_dim(self, parameters: Any, kind: Any, shape: Any, x: Array) -> Array:
        axes = [1] * len(shape)
        for axis, size in zip(parameters["broadcast_dimensions"], x.shape, strict=True):
            axes[axis] = size
        return np.broadcast_to(x.reshape(axes), shape)

    def _transpose(self, parameters: Any, kind: Any, shape: Any, x: Array) -> Array:
        return x.transpose(parameters["permutation"])

    def _rev(self, parameters: Any, kind: Any, shape: Any, x: Array) -> Array:
        return np.flip(x, parameters["dimensions"])

    def _concatenate(self, parameters: Any, kind: Any, shape: Any, *arrays: Array) -> Array:
        return np.concatenate(arrays, parameters["dimension"])

    def _stack(self, parameters: Any, kind: Any, shape: Any, *arrays: Array) -> Array:
        return np.stack(arrays, parameters.get("axis", 0))

    def _split(self, parameters: Any, kind: Any, shape: Any, x: Array) -> list[Array]:
        return np.split(x, np.cumsum(parameters["sizes"])[:-1], parameters["axis"])

    def _slice(self, parameters: Any, kind: Any, shape: Any, x: Array) -> Array:
        strides = parameters["strides"] or [1] * x.ndim
        ends = zip(parameters["start_indices"], parameters["limit_indices"], strides, strict=True)
        return x[tuple(slice(*one) for one in ends)]

    def _pad(self, parameters: Any, kind: Any, shape: Any, x: Array, value: Array) -> Array | None:
        config = parameters["padding_config"]
        if any(min(one) < 0 for one in config):
            return None
        result = np.broadcast_to(value, shape).copy()
        result[
            tuple(
                slice(low, size - high, between + 1) for (low, high, between), size in zip(config, shape, strict=True)
            )
        ] = x
        return result
