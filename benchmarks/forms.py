"""Where DoubleExponentialLaw comes from: forms of a force law, by their errors at whole pressures left out.

    python benchmarks/forms.py [--best 20]

A form is a sum of up to seven terms, each a function of pressure (1, p, p^2, ln(1 + p/p_a)) times one of contraction
(1, eps, eps^2, exp(-mu eps), exp(-r mu eps) with r = 2, 3 or 4), a constant and one in proportion to the pressure
always among them; with mu that is up to eight numbers. All are fitted to both measured tables of the catalog, mu on a
grid. They are ranked by the largest of four errors: on each table at single pressures left out and at pairs of
neighbouring ones left out, each as a part of that of the exponential law (Eq. 2). It counts against a form if a taut
muscle of it would pull harder when shorter or less at more pressure, at -3..25 % and 0..8 bar. Of the forms that are
printed the errors at single pressures are given once more with the decay refined without each of these pressures: that
is what an identification does, and not every form stays where it was. Takes a minute or two.
"""

import argparse
import itertools

import numpy as np

from mckibben import catalog
from mckibben.units import atm, bar

TABLES = {"map": "dmsp-10-250-martens2017", "chart": "festo-tool-10mm"}
RATIOS = (2, 3, 4)
DECAYS = np.array([3, 4.5, 7, 9, 11, 12.5, 14, 16, 19, 24, 30, 34, 40, 50])
PRESSURES = {
    "1": np.ones_like,
    "p": lambda p: p / bar,
    "p2": lambda p: (p / bar) ** 2 / 10,
    "ln": lambda p: np.log1p(p / atm),
}
CONTRACTIONS = ("1", "e", "e2", "slow", "fast")
TERMS = [(p, c) for p in PRESSURES for c in CONTRACTIONS]
ALWAYS = [TERMS.index(("1", "1")), TERMS.index(("p", "1"))]
EQ_2 = [("1", "1"), ("p", "1"), ("1", "e"), ("p", "e"), ("1", "slow"), ("p", "slow")]
OURS = {("1", "1"), ("p", "1"), ("p2", "1"), ("p", "e"), ("1", "slow"), ("1", "fast"), ("ln", "fast")}
RIDGE = 1e-12


def columns(pressure, contraction, decay, ratio):
    """Every term at every point, shape (points, terms)."""
    slow = np.exp(-decay * contraction)
    shapes = {
        "1": np.ones_like(slow),
        "e": contraction * 10,
        "e2": (contraction * 10) ** 2,
        "slow": slow,
        "fast": slow**ratio,
    }
    return np.stack([PRESSURES[p](pressure) * shapes[c] for p, c in TERMS], axis=1)


def errors(points, forms, decay, ratio):
    """RMSE of many forms at the points fitted to, and at single and at pairs of pressures left out."""
    terms = columns(points.pressure, points.contraction, decay, ratio)
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
    answer = [np.sqrt(seen / len(points))]
    for together in (1, 2):
        unseen, count = np.zeros(len(forms)), 0
        for first in range(len(points.pressures) - together + 1):
            out = np.isin(points.levels, points.pressures[first : first + together])
            rest = gram - terms[out].T @ terms[out], right - terms[out].T @ points.force[out]
            unseen += squares(out, solved(*rest))
            count += np.count_nonzero(out)
        answer.append(np.sqrt(unseen / count))
    return answer


def refined(points, form, ratio):
    """The error at single pressures left out, the decay found anew on a fine grid without each of them."""
    decays = np.geomspace(DECAYS[0], DECAYS[-1], 150)
    squares = 0.0
    for level in points.pressures:
        out = points.levels == level
        best = np.inf
        for decay in decays:
            terms = columns(points.pressure, points.contraction, decay, ratio)[:, form]
            terms = terms / np.linalg.norm(terms, axis=0)
            coefficients = np.linalg.lstsq(terms[~out], points.force[~out], rcond=None)[0]
            missed = points.force - terms @ coefficients
            if missed[~out] @ missed[~out] < best:
                best, unseen = missed[~out] @ missed[~out], missed[out] @ missed[out]
        squares += unseen
    return np.sqrt(squares / len(points))


def is_muscle(points, form, decay, ratio):
    """Whether the fitted form falls with contraction and rises with pressure wherever it is taut."""
    contraction, pressure = np.meshgrid(np.linspace(-0.03, 0.25, 57), np.linspace(0, 8 * bar, 33), indexing="ij")
    terms = columns(points.pressure, points.contraction, decay, ratio)[:, form]
    coefficients = np.linalg.lstsq(terms, points.force, rcond=None)[0]
    force = columns(pressure.ravel(), contraction.ravel(), decay, ratio)[:, form] @ coefficients
    force = force.reshape(pressure.shape)
    rises = np.diff(force, axis=0)[force[:-1] > 0].max()
    falls = np.diff(force, axis=1)[force[:, 1:] > 0].min()
    return rises < 0 < falls


def search(points, forms, ratio):
    """The best decay of each form, and its errors at pressures and at pairs left out: arrays of shape (forms,)."""
    best = np.full(len(forms), np.inf)
    kept = np.full((3, len(forms)), np.inf)
    for decay in DECAYS:
        for start in range(0, len(forms), 4000):
            part = slice(start, start + 4000)
            seen, single, pairs = errors(points, forms[part], decay, ratio)
            better = seen < best[part]
            best[part][better] = seen[better]
            kept[:, part][:, better] = np.stack([np.full(len(seen), decay), single, pairs])[:, better]
    return kept


def main():
    parser = argparse.ArgumentParser(description="Forms of a force law, by their errors at pressures left out.")
    parser.add_argument("--best", type=int, default=20, help="how many to print")
    shown = parser.parse_args().best
    tables = {name: catalog.dataset(entry).taut for name, entry in TABLES.items()}
    eq_2 = {
        name: search(points, np.array([[TERMS.index(t) for t in EQ_2]]), 2)[1:, 0] for name, points in tables.items()
    }
    others = [i for i in range(len(TERMS)) if i not in ALWAYS]
    found = []
    for ratio, count in itertools.product(RATIOS, (3, 4, 5)):
        forms = np.array([(*ALWAYS, *more) for more in itertools.combinations(others, count)])
        results = {name: search(points, forms, ratio) for name, points in tables.items()}
        parts = np.max([results[name][1:] / eq_2[name][:, None] for name in tables], axis=(0, 1))
        found += [
            (parts[i], ratio, tuple(forms[i]), {name: r[:, i] for name, r in results.items()})
            for i in range(len(forms))
        ]
    found.sort(key=lambda entry: entry[0])
    ours = {TERMS.index(term) for term in OURS}
    print(f"{len(found)} forms; decay [1/percent], errors at single and at pairs of pressures left out [N]: map, chart")
    print("Eq. 2:", "  ".join(f"{single:.2f} {pairs:.2f}" for single, pairs in eq_2.values()))
    kept = [(i + 1, *entry) for i, entry in enumerate(found) if i < shown or (set(entry[2]), entry[1]) == (ours, 3)]
    for place, part, ratio, form, results in kept:
        again = "  ".join(f"{refined(points, list(form), ratio):5.2f}" for points in tables.values())
        errs = "  ".join(f"{decay / 100:.3f} {single:5.2f} {pairs:5.2f}" for decay, single, pairs in results.values())
        muscle = all(is_muscle(points, list(form), results[name][0], ratio) for name, points in tables.items())
        remarks = ["no muscle"] * (not muscle) + ["<- ours"] * ((set(form), ratio) == (ours, 3))
        names = " ".join(f"{p}*{c}" for p, c in (TERMS[i] for i in form))
        print(
            f"{place:5d} {len(form) + 1} {part:.3f}  {errs}  refined {again}  r={ratio} {names}  {', '.join(remarks)}"
        )


if __name__ == "__main__":
    main()
