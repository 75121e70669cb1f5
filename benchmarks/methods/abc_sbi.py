"""sbi (optional): SMCABC, variant C, each tolerance the median of the population before.

By itself it goes on until a number of simulations is spent, whatever the tolerance is by then; here two of
its methods are wrapped so that the last tolerance is epsilon. It simulates in batches, and so does ours.
"""

import numpy as np

from benchmarks.abc_problem import LOWER, UPPER
from benchmarks.methods.result import Accepted, equally_weighted

DECAY = 0.5  # share of a population within the next tolerance
BUDGET = 1_000_000  # simulations, never reached


def method(problem, seed):
    """One run with the batched simulator."""
    import torch
    from sbi.inference import SMCABC
    from sbi.utils import BoxUniform

    class DownTo(SMCABC):
        def _get_next_epsilon(self, distances, quantile):
            return max(super()._get_next_epsilon(distances, quantile), problem.exact.epsilon)

        def _sample_next_population(self, *, epsilon, **rest):
            population = super()._sample_next_population(epsilon=epsilon, **rest)
            if epsilon <= problem.exact.epsilon:
                self.num_simulations = self.simulation_counter
            return population

    def simulate(theta):
        rho = problem.rho(theta.numpy().astype(np.float64))
        return torch.as_tensor(rho[:, None], dtype=torch.float32)

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    sampler = DownTo(
        simulate,
        BoxUniform(torch.full((2,), LOWER), torch.full((2,), UPPER)),
        distance="l1",
        simulation_batch_size=None,
        show_progress_bars=False,
    )
    _, populations = sampler(
        torch.zeros(1, 1),
        num_particles=problem.draws,
        num_initial_pop=problem.draws,
        num_simulations=BUDGET,
        epsilon_decay=DECAY,
        distance_based_decay=True,
        return_summary=True,
    )
    weights = np.exp(populations["weights"][-1].numpy().astype(np.float64))
    points = populations["particles"][-1].numpy().astype(np.float64)
    return Accepted(
        equally_weighted(points, weights, np.random.default_rng(seed)), sampler.simulation_counter
    )
