"""What is connected to a rig's terminals, without pressing or moving anything."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mckibben.errors import RigError
from mckibben.rig.backend import AnalogChannel
from mckibben.rig.calibration import Calibration
from mckibben.rig.ni.backend import NiBackend
from mckibben.rig.ni.driver import Driver, Terminals

_LOOK = 0.1  # s


class ChannelStatus(NamedTuple):
    """One thing that a rig needs.

    Attributes
    ----------
    name, where
        "pressure" at "Dev1/ai1"; "driver", "devices".
    reading
        What is there, or reads: "0.0131 V, 1.31e+03 Pa"; empty where nothing is.
    problem
        What is missing or wrong, and what to do; empty where all is well.
    """

    name: str
    where: str
    reading: str
    problem: str = ""


def channel_status(
    wiring: Terminals | None = None, calibrations: Mapping[str, Calibration] | None = None, *, server: str = ""
) -> list[ChannelStatus]:
    """Look for driver, devices and terminals, and read each sensor for a tenth of a second.

    The muscle stays vented, and nothing moves. What is missing is told, and does not raise.

    Parameters
    ----------
    wiring
        Which terminal goes where; the paper's rig unless given.
    calibrations
        Of the inputs, by name, so that readings have a unit and a lost sensor is seen; those given.
    server
        As for `NiBackend`.
    """
    wiring, calibrations = wiring or Terminals(), calibrations or {}
    found: list[ChannelStatus] = []
    try:
        driver = Driver(server)
    except RigError as error:
        return [ChannelStatus("package", "", "", str(error))]
    try:
        found.append(ChannelStatus("driver", server or "this machine", f"NI-DAQmx {driver.version()}"))
        devices = driver.devices()
    except RigError as error:
        return [*found, ChannelStatus("driver", server or "this machine", "", str(error))]
    finally:
        driver.close()
    found += [ChannelStatus("device", name, f"{model}, serial {serial}") for name, (model, serial) in devices.items()]
    if not devices:
        found.append(ChannelStatus("device", "", "", "no device is connected; check its cable and power"))
    for name, where in wiring.inputs.items():
        found.append(
            _looked_at(AnalogChannel(name, *wiring.input_range, where), wiring, calibrations.get(name), server)
        )
    others = {**wiring.outputs, **wiring.lines} | ({"counter": wiring.counter} if wiring.counter else {})
    for name, where in others.items():
        device = where.split("/")[0]
        missing = "" if device in devices else f"no device {device}; correct the address in the wiring"
        found.append(ChannelStatus(name, where, "" if missing else "not tried", missing))
    return found


def _looked_at(
    channel: AnalogChannel, wiring: Terminals, calibration: Calibration | None, server: str
) -> ChannelStatus:
    """Of one input, by itself, so that one that is missing does not hide the others."""
    alone = _Looking(
        Terminals(inputs={channel.name: channel.where}, input_range=wiring.input_range, counter=""), server=server
    )
    try:
        alone.open()
        volts = alone.read(round(_LOOK * alone.rate)).volts[:, 0]
    except RigError as error:
        return ChannelStatus(channel.name, channel.where, "", str(error))
    finally:
        alone.close()
    reading = f"{np.mean(volts):.4f} V"
    lost = np.abs(volts) >= max(map(abs, wiring.input_range))
    if calibration is not None:
        reading += f", {float(np.mean(calibration.si(volts))):.4g} {calibration.unit}"
        lost = calibration.lost(volts, channel)
    reading += f" (noise {np.std(volts) * 1e3:.2f} mV)"
    problem = "no working sensor reads that; check its plug and its supply" if lost.any() else ""
    return ChannelStatus(channel.name, channel.where, reading, problem)


class _Looking(NiBackend):
    """Inputs alone: no output, line or counter is touched."""

    def _take_hold_of_outputs(self, driver: Driver) -> None:
        return
