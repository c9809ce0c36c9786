"""Search for the form of TripleExponentialLaw: force laws by their cross-validation error over pressures.

    python benchmarks/forms.py [--best 20]

A form is a sum of six or seven terms, each a function of pressure (1, p, p^2, ln(1 + p/p_a)) times one of contraction
(1, eps, eps^2, exp(-mu eps), and exponentials of twice and four times that decay), a constant and one in proportion to
the pressure always among them; with mu that is seven or eight numbers. Four muscles: the two measured tables of the
catalog, and points made by its two published laws, Eq. 3 and Sarosi's. For each form mu is sought on a grid, for each
muscle anew. Forms are ranked by the largest of their errors at pressures left out, as a part of that of the exponential
law (Eq. 2) for the tables, and of 3 N for the published laws, which Eq. 2 contains.

Of the forms that are printed the errors on the tables are given once more with the decay refined without each pressure,
which is what an identification does, and so for the chart at every second pressure: not every form stays where it was.
It counts against a form if a taut muscle of it would pull harder when shorter or less at more pressure, at -3..25 % and
0..8 bar. Takes a minute or two.
"""

import argparse
import itertools

import numpy as np

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.muscle import forces
from mckibben.units import atm, bar

TABLES = {"map": "dmsp-10-250-martens2017", "chart": "festo-tool-10mm"}
DECAYS = np.array([3, 4.5, 7, 9, 11, 12.5, 14, 16, 19, 24, 30, 34, 40, 50])
PRESSURES = {
    "1": np.ones_like,
    "p": lambda p: p / bar,
    "p2": lambda p: (p / bar) ** 2 / 10,
    "ln": lambda p: np.log1p(p / atm),
}
CONTRACTIONS = ("1", "e", "e2", "slow", "mid", "fast")
TERMS = [(p, c) for p in PRESSURES for c in CONTRACTIONS]
ALWAYS = [TERMS.index(("1", "1")), TERMS.index(("p", "1"))]
EQ_2 = [("1", "1"), ("p", "1"), ("1", "e"), ("p", "e"), ("1", "slow"), ("p", "slow")]
PUBLISHED = {"Eq. 3": "lei-mas-10-180n", "Sarosi": "sarosi-dmsp-10"}
ALLOWED = 3.0  # N, of the published laws
OURS = {("1", "1"), ("p", "1"), ("p", "e"), ("p2", "slow"), ("1", "mid"), ("1", "fast"), ("ln", "fast")}
RIDGE = 1e-12


def columns(pressure, contraction, decay):
    """Every term at every point, shape (points, terms)."""
    slow = np.exp(-decay * contraction)
    shapes = {
        "1": np.ones_like(slow),
        "e": contraction * 10,
        "e2": (contraction * 10) ** 2,
        "slow": slow,
        "mid": slow**2,
        "fast": slow**4,
    }
    return np.stack([PRESSURES[p](pressure) * shapes[c] for p, c in TERMS], axis=1)


def errors(points, forms, decay):
    """RMSE of many forms at the points fitted to, and at pressures left out; shape (forms,)."""
    terms = columns(points.pressure, points.contraction, decay)
    terms = terms / np.linalg.norm(terms, axis=0)
    gram, right = terms.T @ terms, terms.T @ points.force
    ridge = RIDGE * np.eye(forms.shape[1])

    def solved(gram, right):
        chosen = gram[forms[:, :, None], forms[:, None, :]] + ridge
        return np.linalg.solve(chosen, right[forms][..., None])[..., 0]

    def squares(rows, coefficients):
        modelled = np.einsum("ntk,tk->nt", terms[rows][:, forms], coefficients)
        return ((points.force[rows][:, None] - modelled) ** 2).sum(axis=0)

    seen = squares(np.ones(len(points), bool), solved(gram, right))
    cross_validation = np.zeros(len(forms))
    for level in points.pressures:
        out = points.levels == level
        rest = gram - terms[out].T @ terms[out], right - terms[out].T @ points.force[out]
        cross_validation += squares(out, solved(*rest))
    return np.sqrt(seen / len(points)), np.sqrt(cross_validation / len(points))


def refined(points, form):
    """The error at single pressures left out, the decay found anew on a fine grid without each of them."""
    decays = np.geomspace(DECAYS[0], DECAYS[-1], 150)
    squares = 0.0
    for level in points.pressures:
        out = points.levels == level
        best = np.inf
        for decay in decays:
            terms = columns(points.pressure, points.contraction, decay)[:, form]
            terms = terms / np.linalg.norm(terms, axis=0)
            coefficients = np.linalg.lstsq(terms[~out], points.force[~out], rcond=None)[0]
            missed = points.force - terms @ coefficients
            if missed[~out] @ missed[~out] < best:
                best, cross_validation = missed[~out] @ missed[~out], missed[out] @ missed[out]
        squares += cross_validation
    return np.sqrt(squares / len(points))


def is_muscle(points, form, decay):
    """Whether the fitted form falls with contraction and rises with pressure wherever it is taut."""
    contraction, pressure = np.meshgrid(np.linspace(-0.03, 0.25, 57), np.linspace(0, 8 * bar, 33), indexing="ij")
    terms = columns(points.pressure, points.contraction, decay)[:, form]
    coefficients = np.linalg.lstsq(terms, points.force, rcond=None)[0]
    force = columns(pressure.ravel(), contraction.ravel(), decay)[:, form] @ coefficients
    force = force.reshape(pressure.shape)
    rises = np.diff(force, axis=0)[force[:-1] > 0].max()
    falls = np.diff(force, axis=1)[force[:, 1:] > 0].min()
    return rises < 0 < falls


def search(points, forms):
    """The best decay of each form, and its error at pressures left out: shape (2, forms)."""
    best = np.full(len(forms), np.inf)
    kept = np.full((2, len(forms)), np.inf)
    for decay in DECAYS:
        for start in range(0, len(forms), 4000):
            part = slice(start, start + 4000)
            seen, cross_validation = errors(points, forms[part], decay)
            better = seen < best[part]
            best[part][better] = seen[better]
            kept[:, part][:, better] = np.stack([np.full(len(seen), decay), cross_validation])[:, better]
    return kept


def muscles():
    """The taut points of the four, by name."""
    found = {name: catalog.dataset(entry).taut for name, entry in TABLES.items()}
    for name, entry in PUBLISHED.items():
        pressure, contraction = (
            a.ravel() for a in np.meshgrid(np.arange(1, 6.1, 0.5) * bar, np.linspace(-0.03, 0.24, 19))
        )
        force = forces(catalog.law(entry), contraction, pressure)
        there = (force > 5) & (force < 640)
        found[name] = IsobaricDataset.of(pressure=pressure[there], contraction=contraction[there], force=force[there])
    return found


def main():
    parser = argparse.ArgumentParser(description="Forms of a force law, by their errors at pressures left out.")
    parser.add_argument("--best", type=int, default=20, help="how many to print")
    shown = parser.parse_args().best
    data = muscles()
    exponential = np.array([[TERMS.index(term) for term in EQ_2]])
    scale = {name: search(data[name], exponential)[1, 0] for name in TABLES} | dict.fromkeys(PUBLISHED, ALLOWED)
    others = [i for i in range(len(TERMS)) if i not in ALWAYS]
    found = []
    for count in (4, 5):
        forms = np.array([(*ALWAYS, *more) for more in itertools.combinations(others, count)])
        results = {name: search(points, forms) for name, points in data.items()}
        parts = np.max([results[name][1] / scale[name] for name in data], axis=0)
        found += [
            (part, tuple(form), {name: result[:, i] for name, result in results.items()})
            for i, (part, form) in enumerate(zip(parts, forms, strict=True))
        ]
    found.sort(key=lambda entry: entry[0])
    print(f"{len(found)} forms; decay [1/percent] and error at pressures left out [N] on {', '.join(data)}")
    ours = {TERMS.index(term) for term in OURS}
    chart = data["chart"]
    sparse = chart.select(np.isin(chart.levels, [0.0, 2 * bar, 4 * bar, 6 * bar, 8 * bar]))
    eq_2 = " ".join(f"{refined(points, exponential[0].tolist()):5.2f}" for points in (data["map"], chart, sparse))
    print(f"Eq. 2: {', '.join(f'{scale[name]:.2f} N' for name in TABLES)}; refined {eq_2}")
    for place, (part, form, results) in enumerate(found):
        if place >= shown and set(form) != ours:
            continue
        errs = "  ".join(f"{decay / 100:.3f} {unseen:5.2f}" for decay, cross_validation in results.values())
        again = " ".join(f"{refined(points, list(form)):5.2f}" for points in (data["map"], chart, sparse))
        muscle = all(is_muscle(points, list(form), results[name][0]) for name, points in data.items())
        remarks = ["no muscle"] * (not muscle) + ["<- ours"] * (set(form) == ours)
        names = " ".join(f"{p}*{c}" for p, c in (TERMS[i] for i in form))
        print(f"{place + 1:5d} {len(form) + 1} {part:.3f}  {errs}  refined {again}  {names}  {', '.join(remarks)}")


if __name__ == "__main__":
    main()
