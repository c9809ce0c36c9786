import pytest

from mckibben.numerics.runtime import with_loop_option

LOOP = "xla_cpu_small_while_loop_byte_threshold"


def test_our_option_is_the_only_one_when_there_was_none():
    assert with_loop_option("") == f"--xla_backend_extra_options={LOOP}=1000000000"


def test_the_users_flags_stay_in_front():
    assert with_loop_option("--xla_a=1 --xla_b=2").startswith("--xla_a=1 --xla_b=2 --xla_backend_extra_options=")


def test_a_list_of_extra_options_of_the_user_grows():
    flags = with_loop_option("--xla_a=1 --xla_backend_extra_options=foo=2,bar=3 --xla_b=2")
    assert flags == f"--xla_a=1 --xla_backend_extra_options={LOOP}=1000000000,foo=2,bar=3 --xla_b=2"


@pytest.mark.parametrize("mine", ["0", "7"])
def test_a_choice_of_the_users_about_the_same_option_is_kept(mine):
    flags = f"--xla_backend_extra_options={LOOP}={mine}"
    assert with_loop_option(flags) == flags


def test_adding_twice_is_adding_once():
    once = with_loop_option("--xla_a=1")
    assert with_loop_option(once) == once
