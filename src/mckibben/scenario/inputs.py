"""Data, laws and joints named by a user: an entry of the catalog or a file."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben import catalog
from mckibben.component.calls import checked_call
from mckibben.component.schema import read_component
from mckibben.config.document import read_document
from mckibben.config.model import read_text
from mckibben.errors import CallError, NotInCatalogError, ParameterError, described, plain_name, quoted, suggest
from mckibben.joint import AntagonisticJoint, Geometry, PairedPaths

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.identification import FitWithFriction
    from mckibben.muscle import ForceLaw, Specimen


def data_named(names: str | Sequence[str], recipe: Recipe | None = None) -> IsobaricDataset:
    """Return a dataset of the catalog, or of files of measurements.

    Parameters
    ----------
    names
        Name of an entry, or paths of files that are joined; a file comes before an entry of the same name.
    recipe
        How files are read. Default: by their headings.

    Raises
    ------
    NotInCatalogError
        If there is neither a file nor an entry of a name, or an entry is given with a recipe or with other files.
    FileError
        If a file cannot be read.

    Examples
    --------
    >>> len(data_named("festo-tool-10mm"))
    120
    """
    from mckibben.dataset import Recipe, read_dataset
    from mckibben.dataset.reading import check_points

    recipe = recipe or Recipe()
    names = [names] if isinstance(names, str) else names
    entry = next((name for name in names if not Path(name).is_file() and name in catalog.names("datasets")), None)
    if entry and len(names) > 1:
        message = f"{entry} is a dataset of the catalog, which cannot be joined with others"
        raise NotInCatalogError(message, value=entry, remedy="give one dataset of the catalog, or files only")
    if entry and recipe != Recipe():
        options = "--read, --column, --initial-length"
        remedy = f"leave out the options that read files ({options})"
        raise NotInCatalogError(f"{entry} is a dataset of the catalog", value=entry, remedy=remedy)
    if entry:
        return catalog.dataset(entry)
    for name in names:
        if not Path(name).exists() and not re.search(r"[./\\]", name):
            message = f"there is no file {name!r}, and no dataset of that name"
            raise NotInCatalogError(message, value=name, remedy=suggest(name, catalog.names("datasets")))
    dataset = read_dataset(names, recipe, geometry=geometry_named(recipe.joint))
    kind = dataset.table.attrs["specimen"]
    if kind in catalog.names("specimens") or Path(kind).suffix in (".yaml", ".yml"):
        check_points(dataset, names[0], recipe.accept, specimen_named(kind))
    return dataset


@checked_call
def identify(
    data: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | IsobaricDataset,
    law: str | type[ForceLaw] = "exponential",
    *,
    friction: bool | str | None = None,
    robust: bool = True,
    recipe: Recipe | str | os.PathLike[str] | None = None,
    **options: object,
) -> FitWithFriction:
    """Identify a force law, with friction and drift where loading and unloading differ.

    Parameters
    ----------
    data
        Points; or a file, several files of one test, or a dataset of the catalog by name.
    law
        Force law, by name (`mckibben catalog` lists them) or as a class.
    friction
        True or False to fit with or without friction, or the form of the friction, such as "coulomb". Default: as for
        `identify_with_friction`.
    robust
        False to keep outliers.
    recipe, options
        How files are read: a `Recipe` or its file, and its attributes by name, such as ``initial_length="280 mm"``.

    Raises
    ------
    NotInCatalogError
        If there is no law, file or dataset of a name.
    DatasetError, ScenarioError
        As `read_dataset`, for files that cannot be read, and for wrong options.
    IdentificationError
        If the points do not determine the parameters.

    Examples
    --------
    >>> round(identify("dmsp-10-250-martens2017", "exponential").estimates["decay"], 1)
    40.0
    """
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.identification import FrictionForm, identify_with_friction

    if isinstance(data, type) or isinstance(law, IsobaricDataset) or (isinstance(law, str) and "." in law):
        text, remedy = f"identify: law is {described(law)}", "are arguments swapped? write identify(data, law)"
        raise CallError(text, field="law", value=law, remedy=remedy)
    law_type = law_type_named(law) if isinstance(law, str) else law
    form = None
    if isinstance(friction, str):
        if friction not in (forms := [form.value for form in FrictionForm]):
            message = f"{quoted(friction)} is not a form of friction"
            remedy = f"take True/False (command line: auto, on, off), {', '.join(forms)}"
            raise ParameterError(message, field="friction", value=friction, remedy=remedy)
        form, friction = FrictionForm(friction), True
    if isinstance(data, IsobaricDataset):
        if recipe or options:
            text = "points are given, which are not read"
            raise ParameterError(text, field=next(iter(options), "recipe"), remedy="give these options to read_dataset")
    else:
        recipe = recipe if isinstance(recipe, Recipe | None) else Recipe.read(recipe)
        names = [data] if isinstance(data, str | os.PathLike) else data
        data = data_named([os.fspath(name) for name in names], (recipe or Recipe()).with_options(options))
    return identify_with_friction(law_type, data, friction=friction, form=form, robust=robust)


def law_named(name: str, *, specimen: str = "") -> ForceLaw:
    """Return a force law by its name or file.

    Parameters
    ----------
    name
        Published parameter set of the catalog, "chou", or a YAML file of a fit or a muscle.
    specimen
        Specimen whose braid angle and diameter Chou's law takes; name or file.

    Raises
    ------
    NotInCatalogError
        If there is no such law or specimen, or "chou" lacks one.
    FileError, ScenarioError
        If a file cannot be read, or has mistakes.

    Examples
    --------
    >>> round(float(law_named("lei-mas-10-180n").force(0.0, 6e5)), 2)
    584.72
    """
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
    """Return a specimen of the catalog, or that of a file of a specimen or muscle.

    Raises `NotInCatalogError` if there is none of that name, `FileError` or `ScenarioError` for a file.
    """
    if Path(name).suffix not in (".yaml", ".yml"):
        return catalog.specimen(name)
    from mckibben.scenario import read_specimen

    return read_specimen(name)


def law_type_named(name: str) -> type[ForceLaw]:
    """Return a class of force laws by its name, in any case, with or without "Law", hyphens and spaces.

    Raises `NotInCatalogError` with the closest name if there is none.

    >>> law_type_named("Tondu-Lopez").__name__
    'TonduLopezLaw'
    """
    from mckibben.muscle import LAWS

    words = {plain_name(law.__name__).removesuffix("law"): law for law in LAWS.values()}
    words |= {plain_name(key): law for key, law in LAWS.items()}
    if law := words.get(plain_name(name)) or words.get(plain_name(name).removesuffix("law")):
        return law
    short = [re.sub(r"(?<!^)(?=[A-Z])", "-", known.removesuffix("Law")).lower() for known in LAWS]
    remedy = f"{suggest(name.lower(), short)}; load the module of a user-defined law first (--extension)"
    raise _unknown("law", name, remedy)


def joint_named(name: str) -> AntagonisticJoint:
    """Return a joint of the catalog, or that of a scenario file.

    Raises `NotInCatalogError` if there is none of that name, `FileError` or `ScenarioError` for a file.
    """
    if Path(name).suffix in (".yaml", ".yml"):
        from mckibben.scenario import Scenario

        return Scenario.read(name).joint
    if name in catalog.names("joints"):
        return catalog.joint(name)
    raise _unknown("joint", name, f"give a scenario file (.yaml), or one of {', '.join(catalog.names('joints'))}")


def geometry_named(name: str | None) -> Geometry | None:
    """Return the geometry of a joint, that of `joint_named`; None without a name.

    A file may be that of a joint or geometry alone, with or without the keys `joint` and `geometry`.
    """
    if not name:
        return None
    path = Path(name)
    data = read_document(read_text(path, "a joint", "docs/scenarios.md")).data if path.is_file() else None
    if not isinstance(data, dict) or {"load", "controller"} & data.keys():
        return joint_named(name).geometry
    joint = data.get("joint", data)
    section = joint.get("geometry", joint) if isinstance(joint, dict) else joint
    if "joint" in data and section is joint:
        return read_component(AntagonisticJoint, path, key="joint").geometry
    alone = isinstance(section, dict) and "path1" in section and not {"class", "from"} & section.keys()
    return read_component(PairedPaths if alone else Geometry, path, key="joint.geometry")


def _unknown(kind: str, name: str, remedy: str) -> NotInCatalogError:
    return NotInCatalogError(f"there is no {kind} {name!r}", value=name, remedy=remedy)
