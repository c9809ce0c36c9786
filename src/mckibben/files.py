"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mckibben.errors import FileError, Problem


@contextmanager
def whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A sibling to write to, which takes the place of `path` when the block ends, and goes if it fails."""
    path = Path(path)
    sibling = path.with_name(f".{uuid.uuid4().hex}.part")
    try:
        yield sibling
        sibling.replace(path)
    finally:
        sibling.unlink(missing_ok=True)


def folder(path: str | os.PathLike[str]) -> Path:
    """A folder to write to, made if need be.

    Raises
    ------
    FileError
        If it cannot be: a file is in the way, or may not be written.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise FileError(str(path), [Problem("it is a file", remedy="give a folder")]) from error
    except OSError as error:
        raise FileError(
            str(path), [Problem(f"it cannot be made: {error.strerror}", remedy="choose another")]
        ) from error
    return path
