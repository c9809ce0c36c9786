"""Data, laws and joints named by a user: an entry of the catalog or a file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben import catalog
from mckibben.component.schema import read_component
from mckibben.config.document import read_document
from mckibben.config.model import read_text
from mckibben.errors import NotInCatalogError, suggest

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.joint import AntagonisticJoint
    from mckibben.muscle import ForceLaw, Specimen


def data_named(names: str | Sequence[str], recipe: Recipe | None = None) -> IsobaricDataset:
    """A dataset of the catalog, or files of measurements, read by the recipe."""
    from mckibben.dataset import Recipe, read_dataset
    from mckibben.dataset.reading import check_points

    recipe = recipe or Recipe()
    names = [names] if isinstance(names, str) else names
    known = catalog.names("datasets")
    entry = next((name for name in names if name in known and not Path(name).is_file()), None)
    if entry and len(names) > 1:
        message = f"{entry} is a dataset of the catalog, which cannot be joined with others"
        raise NotInCatalogError(message, value=entry, remedy="give one dataset of the catalog, or files only")
    if entry and recipe != Recipe():
        options = "--read, --column, --initial-length, --ambient, --accept"
        remedy = f"leave out the options that read files ({options})"
        raise NotInCatalogError(f"{entry} is a dataset of the catalog", value=entry, remedy=remedy)
    if entry:
        return catalog.dataset(entry)
    for name in names:
        if not Path(name).exists() and not re.search(r"[./\\]", name):
            message = f"there is no file {name!r}, and no dataset of that name"
            raise NotInCatalogError(message, value=name, remedy=suggest(name, known))
    dataset = read_dataset(names, recipe)
    if (kind := dataset.table.attrs["specimen"]) in catalog.names("specimens"):
        check_points(dataset, names[0], recipe.accept, catalog.specimen(kind))
    return dataset


def law_named(name: str, *, specimen: str = "") -> ForceLaw:
    """A published parameter set, Chou's law of a specimen ("chou"), or the law of a file of a fit or a muscle."""
    from mckibben.identification import read_law
    from mckibben.muscle import ChouLaw, Muscle

    if Path(name).is_file() or Path(name).suffix in (".yaml", ".yml"):
        data = read_document(read_text(name, "a fit", "docs/files.md")).data
        is_muscle = isinstance(data, dict) and "specimen" in data
        return read_component(Muscle, Path(name)).law if is_muscle else read_law(name)
    if name == "chou":
        if not specimen:
            raise NotInCatalogError(
                "the law 'chou' needs a specimen, whose braid angle and diameter it takes",
                remedy=f"add --read specimen=NAME, a file or one of {', '.join(catalog.names('specimens'))}",
            )
        return ChouLaw.of(specimen_named(specimen))
    if name in catalog.names("laws"):
        return catalog.law(name)
    raise _unknown("law", name, f"give a fit file (.yaml), 'chou', or one of {', '.join(catalog.names('laws'))}")


def specimen_named(name: str) -> Specimen:
    """A specimen of the catalog, or from a file of a specimen or muscle."""
    if Path(name).suffix not in (".yaml", ".yml"):
        return catalog.specimen(name)
    from mckibben.scenario import read_specimen

    return read_specimen(name)


def law_type_named(name: str) -> type[ForceLaw]:
    """A kind of law by its name, in any case, with or without "Law" and hyphens."""
    from mckibben.component.extensions import load_installed
    from mckibben.identification.storage import law_types

    laws: dict[str, type[ForceLaw]] = {}
    for installed in (False, True):
        laws = law_types(installed=installed)
        words = {_plain(law.__name__).removesuffix("law"): law for law in laws.values()}
        words |= {_plain(key): law for key, law in laws.items()}
        if law := words.get(_plain(name)) or words.get(_plain(name).removesuffix("law")):
            return law
    short = [re.sub(r"(?<!^)(?=[A-Z])", "-", known.removesuffix("Law")).lower() for known in laws]
    broken = "".join(f"; {problem}" for problem in load_installed())
    remedy = f"{suggest(name.lower(), short)}; load the module of a user-defined law first (--extension){broken}"
    raise _unknown("law", name, remedy)


def _plain(name: str) -> str:
    return name.lower().replace("-", "").replace("_", "")


def joint_named(name: str) -> AntagonisticJoint:
    """A joint of the catalog, or that of a scenario file."""
    if Path(name).suffix in (".yaml", ".yml"):
        from mckibben.scenario import Scenario

        return Scenario.read(name).joint
    if name in catalog.names("joints"):
        return catalog.joint(name)
    raise _unknown("joint", name, f"give a scenario file (.yaml), or one of {', '.join(catalog.names('joints'))}")


def _unknown(kind: str, name: str, remedy: str) -> NotInCatalogError:
    return NotInCatalogError(f"there is no {kind} {name!r}", value=name, remedy=remedy)
