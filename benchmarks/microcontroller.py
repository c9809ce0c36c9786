"""Controllers of the comparison on a Cortex-M7: code size, stack, memory, and instructions per step in QEMU.

    python benchmarks/microcontroller.py

Needs arm-none-eabi-gcc with newlib (Debian: gcc-arm-none-eabi, libnewlib-arm-none-eabi), and for the instructions
qemu-system-arm.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from mckibben.control import Reference, Sine, Step
from mckibben.export import export
from mckibben.export.containment.limits import Limits
from mckibben.export.hardware import Hardware
from mckibben.robot import RobotScenario
from mckibben.scenario import Scenario
from mckibben.study.compare import Suite
from mckibben.units import deg

COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
CORTEX_M7 = ("-O2", "-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard")
PROCESSORS = {
    "M7": CORTEX_M7,
    "M4F": ("-O2", "-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
    "M0+": ("-O2", "-mcpu=cortex-m0plus", "-mthumb"),
}
"""Options by processor: with a floating-point unit of 64 bits, of 32, and without one."""
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
ROOT = Path(__file__).parents[1]
LIMITS = Limits(lowest_angle=-0.7, highest_angle=0.7)  # the gains of BP are not tuned, and its run is unstable
STARTUP = """
#include <stdint.h>
extern void _start(void);
static void reset(void)
{
    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20; /* floating-point unit */
    __asm volatile("dsb\\n isb");
    _start();
}
static void hang(void) { for (;;) continue; }
__attribute__((section(".vectors"), used)) static void (*const vectors[])(void) = {
    (void (*)(void))0x20400000, reset, hang, hang, hang, hang, hang};
"""


class Footprint(NamedTuple):
    """What a controller takes: code and constants, stack of its functions, both in bytes."""

    code: int
    stack: int


class Replayed(NamedTuple):
    """A replay in QEMU: largest deviation of a command, relative to the largest; instructions per step; memory [B]."""

    deviation: float
    instructions: int
    memory: int


def footprint(folder: Path, name: str = "controller") -> Footprint:
    """Compile an exported controller for a Cortex-M7, without libm; the stack is without that of libm too."""
    command = (COMPILER, *CORTEX_M7, *STRICT, "-fstack-usage", "-c", f"{name}.c")
    subprocess.run(command, cwd=folder, check=True)
    sizes = subprocess.run(
        ("arm-none-eabi-size", f"{name}.o"), cwd=folder, check=True, capture_output=True, text=True
    ).stdout
    rows = [line.split("\t") for line in (folder / f"{name}.su").read_text().splitlines()]
    assert all(kind == "static" for *_, kind in rows)  # nothing of a size that is not known
    own = [int(size) for where, size, _ in rows if f":{name}_" in where]
    helpers = [int(size) for where, size, _ in rows if f":{name}_" not in where]
    return Footprint(int(sizes.splitlines()[1].split()[0]), max(own) + max(helpers, default=0))


def linked(folder: Path, processor: str, name: str = "controller") -> int:
    """Code and constants [B] of a controller with what it needs of the libraries: `math.h`, and numbers in software."""
    kept = [f"-Wl,-u,{name}_{function}" for function in ("defaults", "init", "step", "hold")]
    options = (*PROCESSORS[processor], "-std=c99", "-nostartfiles", "-specs=nosys.specs", "-Wl,--gc-sections", *kept)
    files = (f"-Wl,-e,{name}_step", "-ffunction-sections", f"{name}.c", "-o", "linked.elf", "-lm")
    subprocess.run((COMPILER, *options, *files), cwd=folder, check=True, capture_output=True)
    sizes = ("arm-none-eabi-size", "linked.elf")
    done = subprocess.run(sizes, cwd=folder, check=True, capture_output=True, text=True)
    return int(done.stdout.splitlines()[1].split()[0])


def replayed(folder: Path, name: str = "controller", steps: int = 200_000) -> Replayed:
    """Replay a recorded run on an emulated Cortex-M7; an instruction is a nanosecond of its clock."""
    (folder / "startup.c").write_text(STARTUP)
    places = "-Wl,--section-start=.vectors=0,--section-start=.init=0x1000,-Ttext=0x2000,-Tdata=0x20000000"
    files = ("replay.c", f"{name}.c", "startup.c", "-o", "replay.elf", "-lm")
    subprocess.run((COMPILER, "-std=c99", *CORTEX_M7, "-specs=rdimon.specs", places, *files), cwd=folder, check=True)
    arguments = f"enable=on,target=native,arg=replay,arg=replay.csv,arg={steps}"
    command = (EMULATOR, "-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none", "-icount", "shift=0")
    done = subprocess.run(
        (*command, "-semihosting-config", arguments, "-kernel", "replay.elf"),
        cwd=folder, check=True, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    deviation, *_ = re.findall(r"([0-9.e+-]+) of the largest", done.stdout)
    ((instructions, memory),) = re.findall(r"(\d+) ns per step .* (\d+) bytes", done.stdout)
    return Replayed(float(deviation), int(instructions), int(memory))


def scenarios(duration: float = 1.0) -> dict[str, Scenario]:
    """A run [s] of each controller of the comparison."""
    suite = Suite.read(ROOT / "examples" / "comparison" / "knee.yaml")
    parts = {name: getattr(suite, name) for name in ("joint", "load", "valve", "sensors", "control_period", "substeps")}
    reference = Reference(Sine(5 * deg, 1.0, phase=90 * deg), Step(14.0, 15.0, at=duration / 2))
    return {
        name: Scenario(name=name, controller=spec, reference=reference, duration=duration, **parts)
        for name, spec in suite.controllers.items()
    }


def main() -> int:
    """Print the table."""
    if shutil.which(COMPILER) is None:
        print(f"there is no {COMPILER}", file=sys.stderr)
        return 1
    title = "| controller | numbers | code [kB] | stack [B] | linked, M7, M4F, M0+ [kB] | memory [B] |"
    print(f"{title} instructions per step | deviation |\n|---|---|---:|---:|---:|---:|---:|---:|")
    leg = RobotScenario.read(ROOT / "examples" / "robot" / "lei-leg-control.yaml")
    for name, scenario in {**scenarios(), "BP": scenarios(0.3)["BP"], "leg": leg}.items():
        for single in (False, True):
            with tempfile.TemporaryDirectory() as made:
                folder = Path(made)
                export(scenario, "c", folder, name="controller", hardware=Hardware(single=single, limits=LIMITS))
                size = footprint(folder)
                row = [name, "float" if single else "double", f"{size.code / 1000:.1f}", f"{size.stack}"]
                row.append(", ".join(f"{linked(folder, processor) / 1000:.1f}" for processor in PROCESSORS))
                if shutil.which(EMULATOR):
                    run = replayed(folder)
                    row += [f"{run.memory}", f"{run.instructions}", f"{run.deviation:.0e}"]
                print("| " + " | ".join(row) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
