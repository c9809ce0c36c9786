import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.muscle import ChouLaw, Muscle
from mckibben.rig import IsobaricProtocol, boundaries
from mckibben.units import bar, mm, percent

SPECIMEN = catalog.specimen("MAS-10-180N-AA-MC-O")
MUSCLE = Muscle(SPECIMEN, catalog.law("lei-mas-10-180n"))


def test_the_papers_protocol_counted_by_hand():
    # -3..25 % of 180 mm are 50.4 mm: plateaus at 0..50 mm. Per pressure and repeat 2 x 51 of them, 6 s each
    # (wait and acquisition), and 2 x 50 moves of 5 s: 1112 s.
    protocol = IsobaricProtocol()
    rows = protocol.plateaus(SPECIMEN)
    assert len(rows.time) == 13 * 5 * 2 * 51 == 6630
    assert rows.time[0] == 5
    assert rows.time[-1] + 1 == pytest.approx(13 * 5 * 1112)
    assert rows.contraction[0] == -3 * percent
    assert rows.contraction[50] == pytest.approx(-3 * percent + 50 / 180)


def test_first_unloading_then_loading_over_the_same_positions():
    rows = IsobaricProtocol().plateaus(MUSCLE)
    for level in range(13):
        for repeat in range(5):
            here = (rows.level == level) & (rows.repeat == repeat)
            unloading, loading = here & ~rows.stretching, here & rows.stretching
            assert np.flatnonzero(unloading)[-1] + 1 == np.flatnonzero(loading)[0]
            assert np.all(np.diff(rows.contraction[unloading]) > 0)
            np.testing.assert_array_equal(rows.contraction[unloading], rows.contraction[loading][::-1])
            assert rows.travel[unloading][0] == rows.travel[loading][0] == 0
            np.testing.assert_allclose(
                np.diff(rows.contraction[here]), -rows.travel[here][1:] / SPECIMEN.initial_length, atol=1e-12
            )


def test_boundaries_keep_the_rated_force_and_end_three_plateaus_into_slack():
    limits = boundaries(MUSCLE, IsobaricProtocol())
    step = 1 * mm / SPECIMEN.initial_length
    limit = 0.95 * 630
    assert np.all(MUSCLE.tension(limits.contraction_min, limits.pressure) <= limit)
    cut = limits.contraction_min > -3 * percent + 1e-9
    assert cut[-1] and not cut[0]
    assert np.all(MUSCLE.tension(limits.contraction_min - step, limits.pressure)[cut] > limit)
    assert np.all(MUSCLE.tension(limits.contraction_max - 2 * step, limits.pressure) == 0)
    taut = MUSCLE.tension(limits.contraction_max - 3 * step, limits.pressure) > 0
    assert np.all(taut | (limits.contraction_max + step > 25 * percent))
    # By hand: at 6 bar zero force is at 23.4 %, between the plateaus of 47 and 48 mm (23.1 and 23.7 %).
    assert limits.contraction_max[-1] == pytest.approx(-3 * percent + 50 * step)


def test_a_pressure_without_any_force_keeps_its_slack_plateaus():
    muscle = Muscle(SPECIMEN, ChouLaw.of(SPECIMEN))
    rows = IsobaricProtocol(pressures=[0.0], repeats=1).plateaus(muscle)
    assert len(rows.time) == 6


def test_a_protocol_that_does_not_suit_the_specimen_says_all_that_is_wrong():
    protocol = IsobaricProtocol(pressures=[6 * bar, 9 * bar, -1 * bar], contraction_min=-6.5 * percent)
    with pytest.raises(RangeError) as error:
        protocol.check(SPECIMEN)
    assert [problem.field for problem in error.value.problems] == ["pressures", "pressures", "contraction_min"]
    for use in (protocol.plateaus, lambda of: boundaries(of, protocol)):
        with pytest.raises(RangeError, match="3 problems"):
            use(MUSCLE)
