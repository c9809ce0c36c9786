"""MuJoCo in Python: the exported joint, compiled and loaded."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

from mckibben.codegen.native import build_library
from mckibben.errors import ExportError

_LOADED: dict[str, Path] = {}  # libraries by name: MuJoCo keeps one plugin per name for the lifetime of the process


def load_mujoco(folder: str | os.PathLike[str], name: str = "") -> Any:
    """The `mujoco.MjModel` of a folder written by `mckibben export --to mjcf`; builds the plugin on first use.

    Raises `ExportError` without MuJoCo or a C compiler, or if a plugin of that name from another folder is loaded
    already, or unless the folder has one model or that of the given name.

    Parameters
    ----------
    name
        Name of the model. Default: that of the only ``*.xml`` in the folder.
    """
    mujoco = import_mujoco()
    folder = Path(folder).resolve()
    name = _only_model(folder, name)
    library, sources = folder / f"lib{name}.so", [folder / f"{name}.c", folder / "plugin.c"]
    if name not in _LOADED:
        if not library.exists() or library.stat().st_mtime < max(source.stat().st_mtime for source in sources):
            build_plugin(library, sources, Path(mujoco.__file__).parent)
        mujoco.mj_loadPluginLibrary(str(library))
        _LOADED[name] = library
    if _LOADED[name] != library:
        remedy = "export one of them with another --name, and load that one"
        message = f"a plugin mckibben.{name} is already loaded from {_LOADED[name].parent}"
        raise ExportError(message, field="name", value=name, remedy=remedy)
    return mujoco.MjModel.from_xml_path(str(folder / f"{name}.xml"))


def _only_model(folder: Path, name: str) -> str:
    """Name of the model in a folder, a given one or the only one."""
    names = sorted(path.stem for path in folder.glob("*.xml"))
    if name in names or (not name and len(names) == 1):
        return name or names[0]
    remedy = (
        f"give the name of one of them: {', '.join(names)}" if names else "write one with mckibben export --to mjcf"
    )
    message = f"{folder} has {len(names)} models" if names and not name else f"{folder} has no model {name}".rstrip()
    raise ExportError(message, field="name", value=name, remedy=remedy)


def import_mujoco() -> Any:
    """MuJoCo; raises `ExportError` without it, or if its packages do not fit each other."""
    try:
        return import_module("mujoco")
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        remedy = "install it: pip install 'mckibben[mujoco]'"
        raise ExportError("MuJoCo is not installed", field="mujoco", remedy=remedy) from error
    except ImportError as error:  # of MuJoCo 4, installed over MuJoCo 3
        remedy = "install its packages again: pip install --force-reinstall --no-deps mujoco mujoco-core mujoco-studio"
        raise ExportError("the packages of MuJoCo are damaged", field="mujoco", remedy=remedy) from error


def build_plugin(library: Path, sources: list[Path], mujoco: Path) -> None:
    """Compile a plugin against the MuJoCo in a folder; raises `CompilerError`."""
    texts = {path.name: path.read_text() for source in sources for path in (source, *source.parent.glob("*.h"))}
    libraries = [str(path) for path in sorted(mujoco.glob("libmujoco.*"))]
    options = ["-std=c99", "-O2", f"-I{mujoco / 'include'}", *(source.name for source in sources), *libraries, "-lm"]
    library.write_bytes(build_library(texts, options))
