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
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.extended_lag import ExtendedLag, curve_columns
from comparisons.missing_effect.extended_parts import (
    REVERSE,
    SHAPE,
    AddedEffect,
    by_record,
    on_segments,
)
from comparisons.missing_effect.fit import TERMS, Fit, Structure
from comparisons.missing_effect.lag_data import TRAIN, LagData
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.loading import block_rows, load_data
from comparisons.missing_effect.noise import Metric, weights_of
from comparisons.missing_effect.probes import Prober
from comparisons.results import FitRows
from surge_core.errors import InputError
from surge_core.types import FloatArray

CURVE_POINTS = 121
_CURVE_NAMES = {REVERSE: "phi^2[phi<0]", SHAPE: "characteristic_shape"}


def value_of(source: LagDiagnosis | Fit, data: LagData | None = None) -> ExtendedLag:
    """Take the numbers out of a diagnosis (its model after), or of a fit and its rows.

    Raises
    ------
    InputError
        When the model holds a term without a name: that says that something is missing and is
        no model of it.
    """
    if isinstance(source, LagDiagnosis):
        return _value(source.after, replace(source.rounds[-1].bench, data=source.data))
    if data is None:
        raise InputError("data", expected="the rows that the fit was made on", found="none")
    bench = _bench(source, data)
    return _value(source, replace(bench, metric=_own_metric(bench)))


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
        if missing is not None:
            raise InputError(
                ", ".join(data.sources),
                expected=f"records in which {added.name} can be detected",
                found=f"some without: it {missing}",
            )
    plain = Metric(model.noise_sigma)
    # The frequency of a ripple is known to one part in the length of a record, and beyond that a
    # search that begins beside it finds another line.
    known = [added for added in model.effects if added.fitted and not added.effect.episodes]
    structure = Structure(model.terms, tuple(added.effect for added in known))
    start = [np.log([model.time_constant_s]), *(added.nonlinear for added in known)]
    fit = refitted_on(Fit(structure, np.concatenate(start)), data, plain)
    for added in model.effects:
        if added not in known:
            fit = _with_effect(fit, added, data, plain)
    metric = _own_metric(_bench(fit, data))
    # In the order in which they were added, whatever order they were searched in.
    structure = Structure(model.terms, tuple(added.effect for added in model.effects))
    start = [fit.nonlinear[:1], *map(fit.values_of, structure.effects)]
    fit = refitted_on(Fit(structure, np.concatenate(start)), data, metric)
    return replace(_value(fit, _bench(fit, data, metric)), estimator=model.estimator)


def _fitted_data(records: Sequence[CoefficientSeries], until_s: Sequence[float] | None) -> LagData:
    """Return the scored rows of records, all of them to be fitted."""
    data = load_data(records)
    data = replace(data, part=np.full(data.n_samples, TRAIN, dtype=np.int8))
    if until_s is not None:
        # The rows stand in the order of the records' clocks.
        order = np.argsort([float(record.time_s[0]) for record in records], kind="stable")
        end_s = np.asarray(until_s, dtype=np.float64)[order][data.record]
        inside = data.sampled(data["time_s"]) <= end_s
        data = replace(data, weight=data.weight * inside).up_to(inside)
    return data.over_all_phi()


def _with_effect(fit: Fit, added: AddedEffect, data: LagData, metric: Metric) -> Fit:
    """Fit one effect more, from where the errors of the model without it tell to begin."""
    found = Prober(fit, data, metric).fitted(added.effect)
    if found is None:
        raise InputError(
            ", ".join(data.sources),
            expected=f"records in which {added.name} can be detected",
            found="none of the rows that it acts on",
        )
    return found


def _bench(fit: Fit, data: LagData, metric: Metric | None = None) -> Bench:
    return Bench(data, fit, metric or Metric(), block_rows(data), 1)


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


def _value(fit: Fit, bench: Bench) -> ExtendedLag:
    for effect in fit.structure.effects:
        if effect.unnamed:
            raise InputError(
                "model",
                expected="effects of the catalogue alone",
                found=f"the term {effect.name}, which has no name",
                remedy="it says that something is missing and is no model of it",
            )
    data, noise = bench.data, bench.noise(fit)
    covariance = covariance_of(fit, bench)
    parameters = fitted_parameters(fit, bench, covariance)
    n_free, n_terms = len(fit.structure.free), len(fit.structure.terms)
    linear = covariance[n_free:, n_free:]
    groups = fit.groups(data)
    effects = tuple(_added(e, parameters[e.name], groups) for e in fit.structure.effects)
    stderr = np.sqrt(np.maximum(np.diag(linear)[:n_terms], 0.0))
    phi = data.sampled(data["phi"])[data.scored()]
    model = ExtendedLag(
        fit.tau_s,
        fit.tau_s * float(np.sqrt(max(covariance[0, 0], 0.0))),
        fit.structure.terms,
        tuple(groups[TERMS].tolist()),
        tuple(stderr.tolist()),
        effects,
        data.references,
        noise.sigma,
        noise.innovation,
        noise.ar,
        trusted_range(phi),
        (),
        int(bench.rows.block.max()) + 1,
    )
    return replace(model, table=_table(model, fit, data, linear, phi))


def _added(
    effect: Effect, parameters: Sequence[FittedParameter], groups: Mapping[str, FloatArray]
) -> AddedEffect:
    kept = () if effect.episodes else groups.get(effect.name, ())
    values, errors = zip(*((p.value, p.stderr) for p in parameters), strict=True)
    return AddedEffect(effect, values, errors, tuple(map(float, kept)))


def _table(
    model: ExtendedLag, fit: Fit, data: LagData, covariance: FloatArray, phi: FloatArray
) -> tuple[tuple[float, float, float], ...]:
    """Return the characteristic over the range of φ with its standard error."""
    grid = np.linspace(float(phi.min()), float(phi.max()), CURVE_POINTS)
    names, coefficients = model.curve_terms()
    columns = curve_columns(names, grid, model)
    slices = fit.structure.layout(data, fit.nonlinear)
    bending = names[len(model.terms) :]
    rows = np.r_[tuple(slices[name] for name in (TERMS, *bending))]
    own = covariance[np.ix_(rows, rows)]
    variance = np.einsum("ij,jk,ik->i", columns, own, columns)
    value = columns @ coefficients
    error = np.sqrt(np.maximum(variance, 0.0))
    return tuple(zip(grid.tolist(), value.tolist(), error.tolist(), strict=True))


def as_estimator(model: ExtendedLag, *, whole_runs: bool = False) -> SimpleNamespace:
    """Return a fitted model with the attributes of an estimator.

    Terms and characteristic are functions of φ alone, of a free shape the largest coefficient that
    it adds; what else the model holds is in ``extended_``, which reconstructs.
    """
    stderr = [*model.stderr, *(one.stderr[0] for one in model.bending)]
    words = [
        f"{name} is left out of the reconstruction: its phase is not known beforehand"
        for name in model.left_out
    ]
    if whole_runs:
        words.append("fitted to unfiltered signals, scored on the filtered rows of the others")

    def characteristic(phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        grid, _, error = np.asarray(model.table).T
        return model.quasi_steady(phi), np.interp(phi, grid, error)

    return SimpleNamespace(
        extended_=model,
        time_constant_s_=model.time_constant_s,
        time_constant_stderr_s_=model.time_constant_stderr_s,
        terms_=[*model.terms, *(_CURVE_NAMES[one.name] for one in model.bending)],
        coef_=[*model.coefficients, *(one.values[0] for one in model.bending)],
        # What the coefficients share is in the error of the characteristic.
        covariance_=np.diag(np.square(stderr)),
        characteristic=characteristic,
        n_blocks_=model.n_blocks,
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
        named = replace(model, estimator=name)
        specs.append(
            EstimatorSpec(
                name, model.label, partial(_fit_rows, named), partial(_fit_records, named)
            )
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
