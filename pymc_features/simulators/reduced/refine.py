"""Modes of one sparse structure from good guesses, by block iteration with its own factor.

With F = K + s M the corrections of a shape x of residual r = K x - lambda M x are sought among F^-1 r,
F^-1 M F^-1 r, ... of all shapes, by the Rayleigh-Ritz method. What a guess from a basis lacks are modes far above
those that are kept, and each power makes the error some ten times smaller.
"""

import numpy as np

POWERS = 3
ROUNDS = 3
INDEPENDENT = 1e-12  # squares of directions below this share of the largest are left out


def refined(system, values, shapes, m, tolerance):
    """omega^2 and shapes (n, q) of which the lowest m are right to a tolerance; None where they do not get there.

    Parameters
    ----------
    system : tuple
        M, K and the factor of K + s M.
    values, shapes : array (q,), (n, q)
        Guesses, M-orthonormal; q >= m.
    m : int
    tolerance : float
        Of the shapes in the norm of the energy, which is that of the residuals by F^-1.
    """
    mass, stiffness, factor = system
    for _ in range(ROUNDS + 1):
        momenta = mass @ shapes
        residuals = stiffness @ shapes - momenta * values
        corrections = factor.solve(np.asfortranarray(residuals))
        errors = np.sqrt(np.maximum((residuals * corrections).sum(axis=0), 0.0) / values)
        if not np.isfinite(errors).all():
            return None
        if (errors[:m] <= tolerance).all():
            return values, shapes
        blocks = [corrections]
        for _ in range(POWERS - 1):
            blocks.append(factor.solve(np.asfortranarray(mass @ blocks[-1])))
        found = best_combinations(mass, stiffness, (values, shapes, momenta), np.hstack(blocks))
        if not (found[0] > 0.0).all():
            return None
        values, shapes = found
    return None


def best_combinations(mass, stiffness, guess, directions):
    """Rayleigh-Ritz values and shapes, as many as guesses, of these and of some directions (n, k)."""
    values, shapes, momenta = guess
    directions = directions / np.sqrt((directions**2).sum(axis=0))
    for _ in range(2):
        directions = directions - shapes @ (momenta.T @ directions)
    squares, turn = np.linalg.eigh(directions.T @ (mass @ directions))
    kept = squares > INDEPENDENT * squares[-1]
    directions = directions @ (turn[:, kept] / np.sqrt(squares[kept]))
    q, forces = values.size, stiffness @ directions
    whole = np.empty((q + directions.shape[1],) * 2)
    whole[:q, :q] = np.diag(values)
    whole[q:, :q] = forces.T @ shapes
    whole[:q, q:] = whole[q:, :q].T
    whole[q:, q:] = directions.T @ forces
    _, mix = np.linalg.eigh(whole)
    better = shapes @ mix[:q, :q] + directions @ mix[q:, :q]
    inertia = (better * (mass @ better)).sum(axis=0)
    better = better / np.sqrt(inertia)
    return (better * (stiffness @ better)).sum(axis=0), better
