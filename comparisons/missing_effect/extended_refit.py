"""Fitting a lag model with effects, and its place beside the other estimators of a comparison."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.harness.estimators import EstimatorSpec
from comparisons.harness.fit_quality import trusted_range
from comparisons.missing_effect.candidates import Bench, refitted_on
from comparisons.missing_effect.conclusion import covariance_of, fitted_parameters
from comparisons.missing_effect.extended_lag import (
    AddedEffect,
    ExtendedLag,
    by_record,
    on_segments,
)
from comparisons.missing_effect.fit import TERMS, Fit, Structure
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.loading import block_rows, load_data
from comparisons.missing_effect.noise import Metric, weights_of
from comparisons.missing_effect.probes import Prober
from comparisons.results import FitRows, FittedLag, evaluate_terms
from surge_core.errors import InputError, require
from surge_core.types import FloatArray

CURVE_POINTS = 121
# Effects that are functions of φ alone, and so bend the characteristic; what a comparison calls
# their largest coefficient.
BENDING = {"reverse_flow_branch": "phi^2[phi<0]", "characteristic_shape": "characteristic_shape"}


def value_of(diagnosis: LagDiagnosis) -> ExtendedLag:
    """Take the numbers out of the model after of a diagnosis.

    Raises
    ------
    InputError
        When the model holds a term without a name: that says that something is missing and is
        no model of it.
    """
    for effect in diagnosis.after.structure.effects:
        found = f"the term {effect.name}, which has no name"
        remedy = "it says that something is missing and is no model of it"
        require(not effect.unnamed, "model", "effects of the catalogue alone", found, remedy)
    return model_of(diagnosis.after, replace(diagnosis.rounds[-1].bench, data=diagnosis.data))


def refitted(
    model: ExtendedLag, records: Sequence[CoefficientSeries], until_s: Sequence[float] | None = None
) -> ExtendedLag:
    """Return a model with all its numbers fitted to other records, each up to a time of its clock.

    τ, characteristic and effects are fitted jointly to every scored row; an effect that was just
    added is searched for first. Records that all carry unfiltered columns are taken as free runs.
    """
    data = _fitted_data(records, until_s)
    for added in model.effects:
        missing = added.effect.missing_channel(data)
        expected = f"records in which {added.name} can be detected"
        without = f"some without: it {missing}"
        require(missing is None, ", ".join(data.sources), expected, without)
    plain = Metric(model.noise_sigma)
    # The frequency of a ripple is known to one part in the length of a record, and beyond that a
    # search that begins beside it finds another line.
    known = [added for added in model.effects if added.fitted and not added.effect.episodes]
    structure = Structure(model.lag.terms, tuple(added.effect for added in known))
    start = [np.log([model.time_constant_s]), *(added.nonlinear for added in known)]
    fit = refitted_on(Fit(structure, np.concatenate(start)), data, plain)
    for added in model.effects:
        if added not in known:
            found = Prober(fit, data, plain).fitted(added.effect)
            if found is None:
                raise InputError(
                    ", ".join(data.sources),
                    expected=f"records in which {added.name} can be detected",
                    found="none of the rows that it acts on",
                )
            fit = found
    data = data.with_known(fit.structure.late_s(fit.nonlinear))
    metric = _own_metric(Bench(data, fit, Metric(), block_rows(data), 1))
    # In the order in which they were added, whatever order they were searched in.
    structure = Structure(model.lag.terms, tuple(added.effect for added in model.effects))
    start = [fit.nonlinear[:1], *map(fit.values_of, structure.effects)]
    fit = refitted_on(Fit(structure, np.concatenate(start)), data, metric)
    return model_of(fit, Bench(data, fit, metric, block_rows(data), 1)).called(model.estimator)


def _fitted_data(records: Sequence[CoefficientSeries], until_s: Sequence[float] | None) -> LagData:
    """Return the scored rows of records, all of them to be fitted."""
    data = load_data(records).all_fitted()
    if until_s is not None:
        # The rows stand in the order of the records' clocks.
        order = np.argsort([float(record.time_s[0]) for record in records], kind="stable")
        end_s = np.asarray(until_s, dtype=np.float64)[order][data.record]
        inside = data.sampled(data["time_s"]) <= end_s
        data = replace(data, weight=data.weight * inside).up_to(inside)
    return data.over_all_phi()


def _own_metric(bench: Bench) -> Metric:
    """Return the metric in which the errors of a fit to all rows are white.

    Of whole runs all errors weigh alike: they are the model's own, and weighing them by their
    colour would fit what is fast, where a lag is worst.
    """
    noise = bench.noise(bench.fit)
    if bench.data.average_s > 0.0:
        return Metric(noise.sigma)
    errors = bench.fit.errors(bench.data, Metric())
    return noise.metric(weights_of(errors, noise, bench.data))


def model_of(fit: Fit, bench: Bench) -> ExtendedLag:
    """Return a fit to all rows of a bench as a model, with the errors of its numbers."""
    data, noise = bench.data, bench.noise(fit)
    covariance = covariance_of(fit, bench)
    parameters = fitted_parameters(fit, bench, covariance)
    linear = covariance[len(fit.structure.free) :, len(fit.structure.free) :]
    groups = fit.groups(data)
    effects = []
    for effect in fit.structure.effects:
        values, errors = zip(*((p.value, p.stderr) for p in parameters[effect.name]), strict=True)
        kept = () if effect.episodes else groups.get(effect.name, ())
        effects.append(AddedEffect(effect, values, errors, tuple(map(float, kept))))
    phi = data.sampled(data["phi"])[data.scored()]
    stderr = np.sqrt(np.maximum(np.diag(linear)[: len(fit.structure.terms)], 0.0))
    lag = FittedLag(
        "extended",
        "psi_p",
        fit.tau_s,
        fit.tau_s * float(np.sqrt(max(covariance[0, 0], 0.0))),
        fit.structure.terms,
        tuple(groups[TERMS].tolist()),
        tuple(stderr.tolist()),
        "first",
        trusted_range(phi),
        _table(fit, data, effects, linear, phi),
        int(bench.rows.block.max()) + 1,
    )
    return ExtendedLag(
        lag, tuple(effects), data.references, noise.sigma, noise.innovation, noise.ar
    )


def _table(
    fit: Fit,
    data: LagData,
    effects: Sequence[AddedEffect],
    covariance: FloatArray,
    phi: FloatArray,
) -> tuple[tuple[float, float, float], ...]:
    """Return the characteristic over the range of φ with its standard error."""
    grid = np.linspace(float(phi.min()), float(phi.max()), CURVE_POINTS)
    terms, slices = fit.structure.terms, fit.structure.layout(data, fit.nonlinear)
    bends = {one.name: one.bend(grid, terms) for one in effects}
    bends[TERMS] = evaluate_terms(list(terms), grid)
    names = [name for name in slices if name in (TERMS, *BENDING)]
    columns = np.column_stack([bends[name] for name in names])
    rows = np.r_[tuple(slices[name] for name in names)]
    variance = np.einsum("ij,jk,ik->i", columns, covariance[np.ix_(rows, rows)], columns)
    table = grid, columns @ fit.coefficients[rows], np.sqrt(np.maximum(variance, 0.0))
    return tuple(zip(*(column.tolist() for column in table), strict=True))


def as_estimator(model: ExtendedLag, *, whole_runs: bool = False) -> SimpleNamespace:
    """Return a fitted model with the attributes of an estimator.

    Terms and characteristic are functions of φ alone, of a free shape the largest coefficient that
    it adds; what else the model holds is in ``extended_``, which reconstructs.
    """
    lag, bending = model.lag, [one for one in model.effects if one.name in BENDING]
    words = [
        f"{one.name} is left out of the reconstruction: its phase is not known beforehand"
        for one in model.effects
        if one.effect.episodes
    ]
    if whole_runs:
        words.append("fitted to unfiltered signals, scored on the filtered rows of the others")

    def characteristic(phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        grid, _, error = np.asarray(lag.table).T
        return model.quasi_steady(phi), np.interp(phi, grid, error)

    return SimpleNamespace(
        extended_=model,
        time_constant_s_=lag.time_constant_s,
        time_constant_stderr_s_=lag.time_constant_stderr_s,
        terms_=[*lag.terms, *(BENDING[one.name] for one in bending)],
        coef_=[*lag.coefficients, *(one.values[0] for one in bending)],
        # What the coefficients share is in the error of the characteristic.
        covariance_=np.diag(np.square([*lag.stderr, *(one.stderr[0] for one in bending)])),
        characteristic=characteristic,
        n_blocks_=lag.n_blocks,
        cautions_=tuple(words),
    )


def extended_specs(
    models: Mapping[str, ExtendedLag], taken: Collection[str] = ()
) -> tuple[EstimatorSpec, ...]:
    """Return how models read from a file take part in a comparison: refitted, structure kept.

    One whose name another estimator has (``taken``) is called ``extended_…``.
    """
    specs = []
    for key, model in models.items():
        name = f"extended_{key}" if key in taken else key
        named, label = model.called(name), " + ".join(["lag", *(e.name for e in model.effects)])
        specs.append(
            EstimatorSpec(name, label, partial(_fit_rows, named), partial(_fit_records, named))
        )
    return tuple(specs)


def _fit_records(
    model: ExtendedLag, records: Sequence[CoefficientSeries], until_s: Sequence[float] | None
) -> SimpleNamespace:
    return as_estimator(refitted(model, records, until_s), whole_runs=True)


def _fit_rows(
    model: ExtendedLag, rows: FitRows, records: Sequence[CoefficientSeries]
) -> SimpleNamespace:
    """Fit the rows alone, with what their records know beside φ."""
    marked = []
    for record, own, at in by_record(rows, records):
        if np.any(own):
            labels = np.zeros(record.n_samples, dtype=np.int64)
            labels[at] = rows.labels[own]
            marked.append(on_segments(record, labels))
    return as_estimator(refitted(model, marked))
