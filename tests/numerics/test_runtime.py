import os
import subprocess
import sys
from pathlib import Path

import pytest

from mckibben.numerics import runtime

X86 = """processor	: 0
vendor_id	: GenuineIntel
model name	: A
cpu MHz		: {mhz}
flags		: fpu sse2 {more}

processor	: 1
flags		: something else
"""
ARM = """processor	: 0
BogoMIPS	: 50.00
Features	: fp asimd {more}
CPU implementer	: 0x41
CPU part	: 0xd0c

"""
RISC = "processor	: 0\nhart		: 0\nisa		: rv64imafdc{more}\n"


@pytest.fixture
def on(tmp_path, monkeypatch):
    """Ask, on a processor of which Linux says this, for its short name; None stands for a system that says nothing."""
    caches = (runtime.processor, runtime._cpuinfo)
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", "")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def ask(text):
        for cached in caches:
            cached.cache_clear()
        (tmp_path / "cpuinfo").unlink(missing_ok=True)
        if text is not None:
            (tmp_path / "cpuinfo").write_text(text, encoding="utf-8")
        monkeypatch.setattr(runtime, "_CPUINFO", tmp_path / "cpuinfo")
        return runtime.processor()

    yield ask
    for cached in caches:
        cached.cache_clear()


@pytest.mark.parametrize("form", [X86.replace("{mhz}", "1"), ARM], ids=["x86", "ARM"])
def test_processors_that_can_do_different_things_have_different_names(on, form):
    plain, wide = on(form.format(more="")), on(form.format(more="avx512f"))
    assert plain is not None
    assert wide not in (None, plain)
    assert on(form.format(more="")) == plain


def test_what_changes_from_start_to_start_is_not_in_the_name(on):
    assert on(X86.format(mhz="1000", more="avx2")) == on(X86.format(mhz="2000", more="avx2"))
    assert on(X86.format(mhz="1000", more="avx2")) != on(X86.format(mhz="1000", more="avx2").replace(": A", ": B"))


@pytest.mark.parametrize("said", [None, "", RISC.format(more="v"), "flags\t\t: \n"])
def test_where_the_processor_cannot_be_told_nothing_is_kept(on, monkeypatch, tmp_path, said):
    assert on(said) is None
    monkeypatch.delenv("MCKIBBEN_PROGRAMS_DIR")
    runtime.use_program_cache()
    assert "MCKIBBEN_PROGRAMS_DIR" not in os.environ
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", str(tmp_path / "asked for"))
    assert runtime.programs_folder() is None


def test_beside_a_cache_of_jax_programs_in_c_alone_are_kept(on, monkeypatch, tmp_path):
    on(X86.format(mhz="1", more=""))
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", str(tmp_path))
    assert runtime.programs_folder() == runtime.xla_programs_folder() == tmp_path
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "theirs"))
    assert (runtime.programs_folder(), runtime.xla_programs_folder()) == (tmp_path, None)


@pytest.mark.parametrize(
    ("flags", "options"), [("sse avx2", {}), ("avx2 avx512f", {"xla_cpu_prefer_vector_width": 512})]
)
def test_batches_fill_the_vector_unit_of_a_cpu_that_is_wide(monkeypatch, flags, options):
    monkeypatch.setattr(runtime, "_cpuinfo", lambda: {"flags": flags})
    assert runtime.batch_options.__wrapped__() == options
    monkeypatch.setattr("jax.default_backend", lambda: "gpu")
    assert runtime.batch_options.__wrapped__() == {}


@pytest.mark.slow
def test_programs_of_a_script_are_kept_unless_the_folder_is_empty(tmp_path):
    script = (
        "import mckibben as mk; mk.Scenario.read('examples/pre-contracted-step-pid.yaml')"
        ".model_copy(update={'duration': 0.02}).simulate()"
    )
    bare = {key: value for key, value in os.environ.items() if not key.startswith(("MCKIBBEN_PROGRAMS", "JAX_COMP"))}
    for name, given in (("kept", {}), ("none", {"MCKIBBEN_PROGRAMS_DIR": ""})):
        environment = bare | given | {"XDG_CACHE_HOME": str(tmp_path / name)}
        subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[2], env=environment, check=True)
    assert [*(tmp_path / "kept").rglob("*.program")] and not (tmp_path / "none").exists()
