from mckibben.numerics.calculus import evenly_spaced


def test_first_and_last_are_among_evenly_spaced_samples():
    assert evenly_spaced(11, 3).tolist() == [0, 5, 10]
    assert evenly_spaced(3, 11).tolist() == [0, 1, 2]
    assert evenly_spaced(1, 4).tolist() == [0]
