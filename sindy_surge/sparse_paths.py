"""Supports of every size: proposed by pysindy's optimizers, and by a beam search for the tests."""

from __future__ import annotations

import copy
import warnings
from typing import Any

import numpy as np

from sindy_surge.linear_problem import LinearProblem, Support
from surge_core.errors import InputError
from surge_core.types import FloatArray

OPTIMIZERS = ("SSR", "STLSQ", "FROLS", "best-subset")

# Dropping the term whose loss hurts least needs one regression for each term left: 0.2 s with
# 20 terms, several seconds with 60.
_MOST_TERMS_FOR_RESIDUAL_CRITERION = 30
_STLSQ_THRESHOLDS = 40


def proposed_supports(linear: LinearProblem, optimizer: Any, max_terms: int) -> list[Support]:
    """Run a pysindy optimizer on the compressed problem and collect the supports on its path.

    The columns have unit norm and the ridge is switched off for the optimizers called by name:
    it would swamp columns this small, and a raw threshold would never prune.

    Raises
    ------
    InputError
        If `optimizer` is neither a known name nor something that fits.
    """
    found: set[Support] = set()
    for candidate in _optimizers(optimizer, linear):
        for coefficients in _history(candidate, linear):
            support = tuple(int(i) for i in np.flatnonzero(coefficients))
            if 0 < len(support) <= max_terms:
                found.add(support)
    return sorted(found, key=lambda s: (len(s), s))


def proposals(
    linear: LinearProblem, optimizer: Any, max_terms: int, required: Support = ()
) -> list[Support]:
    """Return the optimizer's path and, beside it, the best supports of every size.

    A path that drops or adds one term at a time never returns from a wrong turn: one
    exponential that stands in for a parabola keeps backward elimination off the truth.
    """
    rest, free = without_required(linear, required)
    room = max_terms - len(required)
    found: set[Support] = {required} if required else set()
    if room > 0 and free:
        for support in proposed_supports(rest, optimizer, room):
            found.add(tuple(sorted((*required, *(free[i] for i in support)))))
    for ranked in beam_search(linear, max_terms, required=required).values():
        found.update(support for _, support in ranked[:4])
    return sorted(found, key=lambda s: (len(s), s))


def without_required(
    linear: LinearProblem, required: Support
) -> tuple[LinearProblem, tuple[int, ...]]:
    """Project terms that are always in out of a regression."""
    n_terms = linear.columns.shape[1]
    free = tuple(i for i in range(n_terms) if i not in required)
    if not required:
        return linear, free
    basis, _ = np.linalg.qr(linear.columns[:, list(required)])
    columns = linear.columns[:, list(free)]
    columns = columns - basis @ (basis.T @ columns)
    target = linear.target - basis @ (basis.T @ linear.target)
    left = np.linalg.norm(columns, axis=0)
    left[left < 1e-12] = 1.0
    norms = linear.norms[list(free)] * left
    return (
        LinearProblem(columns / left, target, norms, linear.outside, linear.n_equations),
        free,
    )


def _optimizers(optimizer: Any, linear: LinearProblem) -> list[Any]:
    from pysindy.optimizers import FROLS, SSR, STLSQ

    if not isinstance(optimizer, str) and hasattr(optimizer, "fit"):
        # A copy: pysindy's optimizers carry state from one fit to the next.
        return [copy.deepcopy(optimizer)]
    n_terms = linear.columns.shape[1]
    exact = {"solver": "svd"}
    if optimizer == "best-subset":
        return []
    if optimizer == "SSR":
        few = n_terms <= _MOST_TERMS_FOR_RESIDUAL_CRITERION
        criteria = "model_residual" if few else "coefficient_value"
        return [SSR(alpha=0.0, criteria=criteria, max_iter=n_terms, ridge_kw=exact)]
    if optimizer == "FROLS":
        return [FROLS(alpha=0.0, max_iter=n_terms, ridge_kw=exact)]
    if optimizer == "STLSQ":
        # Relative thresholds, from far below the noise to the whole signal.
        size = float(np.linalg.norm(linear.target)) or 1.0
        levels = size * np.geomspace(1e-5, 1.0, _STLSQ_THRESHOLDS)
        return [STLSQ(threshold=v, alpha=0.0, max_iter=2 * n_terms, ridge_kw=exact) for v in levels]
    raise InputError(
        "optimizer",
        expected=f"one of {', '.join(OPTIMIZERS)} or a pysindy optimizer",
        found=repr(optimizer),
    )


def _history(optimizer: Any, linear: LinearProblem) -> list[FloatArray]:
    """Fit and return every coefficient vector met on the way."""
    from sklearn import config_context

    # Hundreds of regressions on some twenty rows: checking the arrays would take most of the time.
    quick = config_context(assume_finite=True, skip_parameter_validation=True)
    with warnings.catch_warnings(), quick:
        # STLSQ warns whenever a threshold removes every term, which ends a sweep as it should.
        warnings.simplefilter("ignore")
        try:
            optimizer.fit(linear.columns, linear.target)
        except ValueError:
            # FROLS stops so on columns that rounding makes dependent; what it found still counts.
            if not getattr(optimizer, "history_", None):
                return []
    met = [
        *getattr(optimizer, "history_", ()),
        *getattr(optimizer, "coef_list", ()),
        getattr(optimizer, "coef_", np.zeros(0)),
    ]
    return [np.ravel(np.asarray(one)) for one in met]


def beam_search(
    linear: LinearProblem, max_terms: int, width: int = 200, required: Support = ()
) -> dict[int, list[tuple[float, Support]]]:
    """Find the best supports of every size by adding terms to the best of one size less.

    With about 20 terms it is exhaustive up to three.
    """
    if required:
        rest, free = without_required(linear, required)
        result = {len(required): [(rest.chi2(()), required)]}
        for size, ranked in beam_search(rest, max_terms - len(required), width).items():
            result[size + len(required)] = [
                (chi2, tuple(sorted((*required, *(free[i] for i in support)))))
                for chi2, support in ranked
            ]
        return result
    columns, target = linear.columns, linear.target
    n_terms = columns.shape[1]
    beam: list[Support] = [()]
    bases = np.zeros((1, columns.shape[0], 0))
    rests = target[None, :]
    found: dict[int, list[tuple[float, Support]]] = {}
    for size in range(1, min(max_terms, n_terms) + 1):
        # One Gram-Schmidt step for every support and every term at once.
        new = columns[None] - bases @ (np.swapaxes(bases, 1, 2) @ columns[None])
        lengths = np.sum(new**2, axis=1)
        usable = lengths > 1e-16
        gains = np.where(usable, np.einsum("bmp,bm->bp", new, rests) ** 2, 0.0)
        gains /= np.where(usable, lengths, 1.0)
        scores = np.sum(rests**2, axis=1)[:, None] - gains
        for number, support in enumerate(beam):
            scores[number, list(support)] = np.inf
        scores[~usable] = np.inf
        best: dict[Support, tuple[float, int, int]] = {}
        for flat in np.argsort(scores, axis=None):
            number, term = divmod(int(flat), n_terms)
            if not np.isfinite(scores[number, term]) or len(best) >= width:
                break
            support = tuple(sorted((*beam[number], term)))
            best.setdefault(support, (float(scores[number, term]), number, term))
        if not best:
            break
        parents = np.array([entry[1] for entry in best.values()])
        added = np.array([entry[2] for entry in best.values()])
        fresh = new[parents, :, added] / np.sqrt(lengths[parents, added])[:, None]
        # A second projection keeps the basis orthogonal for nearly dependent terms.
        old = bases[parents]
        fresh -= np.einsum("bmk,bk->bm", old, np.einsum("bmk,bm->bk", old, fresh))
        fresh /= np.linalg.norm(fresh, axis=1)[:, None]
        bases = np.concatenate((old, fresh[:, :, None]), axis=2)
        rests = rests[parents]
        rests = rests - fresh * np.sum(fresh * rests, axis=1)[:, None]
        beam = list(best)
        found[size] = [
            (max(score, 0.0) + linear.outside, support) for support, (score, _, _) in best.items()
        ]
    return found
