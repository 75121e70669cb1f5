"""Gradients by the statistics of misfits under long records, from tables, and by the march where not sure."""

import numpy as np

from pymc_features.simulators.mean_squares.asked import Asked
from pymc_features.simulators.mean_squares.gradient.derive import Derivatives, derive, new_derivatives
from pymc_features.simulators.mean_squares.gradient.memory import room_of
from pymc_features.simulators.mean_squares.kept import KEPT
from pymc_features.simulators.mean_squares.population import AGREEMENT, MOST_STRIDE, are_sure
from pymc_features.simulators.mean_squares.stencil import coefficients
from pymc_features.simulators.oscillators.reduction import CLOSE

FEWEST_STEPS = 1000  # of the recursion; below, the march is as fast
HEAVY = 1.98  # D over omega from which a pole and its conjugate come too near each other
KERNEL = "population_gradient"


def is_long(stride, observed) -> bool:
    """Whether tables are faster for a population; `mean_squares.population` knows it for one structure."""
    return stride <= MOST_STRIDE and stride * observed.shape[-1] >= FEWEST_STEPS


def misfit_gradient(family, arguments, observed, weights, is_alone=False) -> tuple:
    """Gradient of sum_pjq weights_pjq statistics_pjq by each parameter, in arrays of their shapes.

    Parameters
    ----------
    family : Family
        With the kernels "population_gradient", the march, "gradient_systems" and "gradient_of_sums".
    arguments, observed
        As in `mean_squares`.
    weights : array (p, s, 1) or (p, s, 4)
    is_alone : bool
        Whether there is one structure, to be marched, where it is, by the kernel for one.
    """
    data = KEPT.of(observed, arguments[1])
    asked, tables = Asked(family, arguments, data, is_alone), data.tables(weights.shape[2])
    found = by_tables(asked, tables, weights) if tables else None
    if found is None:
        return asked.march(KERNEL, None, weights)
    if asked.is_due(KERNEL):
        if not data.same(observed, np.atleast_2d(arguments[1].acceleration)):  # changed in place
            KEPT.forget(data)
            return misfit_gradient(family, arguments, observed, weights, is_alone)
        own, few = weights[asked.some], (asked.parameters_of(asked.some), *arguments[1:])
        some = Asked(family, few, data, asked.is_alone)
        if not agree(by_tables(some, tables, own), some.march(KERNEL, None, own)):
            data.drop_tables()
            return asked.march(KERNEL, None, weights)
    return found


def by_tables(asked, tables, weights):
    """Gradients, or None where there are no modes to begin with."""
    names, parts = asked.family.parameters, asked.parts("gradient_systems", tables)
    totals, is_any = [np.zeros_like(getattr(asked.parameters, name)) for name in names], False
    for part, systems, poles in parts:
        sums, is_sure = sums_over_time(asked, tables, systems, poles, weights[part])
        is_any = True
        for which, is_good in ((part[is_sure], True), (part[~is_sure], False)):
            if not which.size:
                continue
            own = asked.parameters_of(which)
            if is_good:
                given = asked.excitation, asked.wanted, tuple(x[is_sure] for x in sums)
                found = asked.family.kernels["gradient_of_sums"](own, *given)
            else:
                found = asked.march(KERNEL, which, weights[which])
            for total, gradient in zip(totals, found, strict=True):
                if len(total) > 1:
                    total[which] = gradient
                else:
                    total += gradient
    return tuple(totals) if is_any else None


def sums_over_time(asked, tables, systems, poles, weights):
    """Three arrays that `reduction.derive_from` goes on from, and whether they are sure, (p,)."""
    count, (n_sensors, n_times), m = len(systems.valid), asked.data.observed.shape, systems.omega.shape[1]
    is_sure = systems.valid & (systems.damping < HEAVY * systems.omega).all(axis=1)
    is_sure &= modes_apart(systems, tables[0].mesh.duration)
    poles = poles._replace(served=poles.served & is_sure)
    found = new_derivatives(count, n_sensors, m)
    by_misfit = np.zeros((count, n_sensors, 3))
    by_misfit[:, :, 0] = weights[:, :, 0] / n_times
    if len(tables) > 1:
        by_misfit[:, :, 1:] = weights[:, :, :1:-1]  # the last and the first misfit
    for i, table in enumerate(tables):
        if i > 0:
            by_misfit = np.zeros((count, n_sensors, 3))
            by_misfit[:, :, 0] = weights[:, :, 1] / n_times
        own = new_derivatives(count, n_sensors, 0) if i > 0 else found
        into = Derivatives(own.squares, own.sizes, *found[2:])
        given = table.mesh, table.of.sums, coefficients(1)
        room = room_of(m, n_sensors, table)
        derive(given, systems, poles, by_misfit, asked.wanted.quantity, room, into)
        is_sure &= are_sure(into.squares, into.sizes, n_times)
    return found[2:], is_sure


def modes_apart(systems, duration):
    """Where no two modes are close as in `close_modes`, nor nearly so, (p,)."""
    omega, damping = systems.omega, systems.damping
    with np.errstate(divide="ignore", invalid="ignore"):
        memory = np.maximum(np.minimum(duration, 2.0 / damping), 3.0 / omega)[:, 1:]
        gap = np.diff(omega, axis=1)
        growth = gap * (omega[:, 1:] + omega[:, :-1]) * duration**2
        return (np.minimum(gap * memory, growth) > 2.0 * CLOSE).all(axis=1)


def agree(found, marched) -> bool:
    """Whether tables and the march give the same, each parameter beside its largest slope."""
    for own, other in zip(found, marched, strict=True):
        scale = abs(np.nan_to_num(other)).max(initial=0.0)
        is_same = (abs(own - other) <= AGREEMENT * scale) | (np.isnan(own) & np.isnan(other))
        if not is_same.all():
            return False
    return True
