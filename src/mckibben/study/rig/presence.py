"""What is connected, what each channel reads, and what is missing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.errors import McKibbenError

if TYPE_CHECKING:
    from mckibben.rig.ni import Presence
    from mckibben.study.rig.building import Setup


def readings(protocol: Path | None) -> Iterator[tuple[str, bool]]:
    """Lines of text, each with whether all is well with what it is about. Nothing is pressed or moved.

    Parameters
    ----------
    protocol
        Whose rig is looked at, and which is then held against its limits; None is the paper's wiring on ``Dev1``.

    Raises
    ------
    ScenarioError
        If the protocol cannot be read.
    """
    from mckibben.rig.ni import present

    if protocol is None:
        yield from map(_line, present())
        return
    from mckibben.study.rig.building import build_setup, build_wiring, read_calibrations
    from mckibben.study.rig.checking import check
    from mckibben.study.rig.document import read_test

    test, document = read_test(protocol)
    card = test.rig.nidaqmx
    if card is not None:
        calibrations = read_calibrations(Path(str(card.calibration)))
        yield from map(_line, present(build_wiring(card), calibrations, server=card.server or ""))
    else:
        yield from _virtual(build_setup(test))
    try:
        checked = check(test, document, source=str(protocol))
    except McKibbenError as error:
        yield str(error), False
        return
    yield checked.describe().splitlines()[-2].strip(), True
    yield "nothing stands against it", True


def _line(found: Presence) -> tuple[str, bool]:
    where = f" at {found.where}" if found.where else ""
    return f"{found.name}{where}: {found.problem or found.reading}", not found.problem


def _virtual(setup: Setup) -> Iterator[tuple[str, bool]]:
    backend, calibrations = setup.backend, setup.bench.calibrations
    yield f"rig: virtual, {backend.rate:g} Hz, vents by itself after {backend.patience:g} s", True
    backend.open()
    try:
        volts = backend.read(max(1, round(0.1 * backend.rate))).volts
    finally:
        backend.close()
    for channel, read in zip(backend.inputs, volts.T, strict=True):
        calibration = calibrations[channel.name]
        lost = bool(calibration.lost(read, channel).any())
        said = (
            "lost: check its plug and its supply" if lost else f"{calibration.si(read).mean():.4g} {calibration.unit}"
        )
        yield f"{channel.name} at {channel.where}: {read.mean():.4f} V, {said}", not lost
    for channel in backend.outputs:
        yield f"{channel.name} at {channel.where}: {channel.low:g}..{channel.high:g} V", True
