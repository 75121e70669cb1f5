"""Cost of one log-likelihood through PyMC, one particle at a time.

Compared: TN and the conventional Gaussian as users write them, which compile to the fused Op; both with
the response stored, held back from the fused Op by a term of 1e-300; and what people write today, a
black-box Op around SciPy in front of TN. Which Op a model compiles to is checked, not assumed.
"""

import pymc as pm

import pymc_features as pmf
from benchmarks.methods.black_box import BlackBox
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds

FIRST = "TN, fused Op"
HOLD_BACK = 1e-300  # too small to change any number, and not a zero that PyTensor would remove


def models(record, data):
    """The models compared, by name."""

    def declare(response, feature=True):
        with pm.Model() as model:
            theta = pm.Uniform("theta", 0.5, 1.5)
            sigma = pm.Uniform("sigma", 0.0, 2.0)
            if feature:
                pmf.TruncNormalFeature("y", mu=response(theta), sigma=sigma, observed=data)
            else:
                pm.Normal("y", mu=response(theta), sigma=sigma, observed=data)
        return model

    def ours(theta):
        return pmf.response(pmf.paper.chain(theta), record)

    def black_box(route):
        op = BlackBox(route, record.dt)
        return declare(lambda theta: op(theta, record.acceleration))

    return {
        FIRST: declare(ours),
        "TN, stored response": declare(lambda theta: ours(theta) + HOLD_BACK * theta),
        "Gaussian, fused Op": declare(ours, feature=False),
        "Gaussian, stored response": declare(lambda theta: ours(theta) + HOLD_BACK * theta, feature=False),
        "TN, black box on eigh + lfilter": black_box("lfilter"),
        "TN, black box on lsim": black_box("lsim"),
    }


def check(name, logp):
    """Stop if a model was compiled to another Op than its name says."""
    compiled = {type(node.op).__name__ for node in logp.f.maker.fgraph.toposort()}
    words = {
        "fused Op": "StructuralDiscrepancy",
        "stored response": "StructuralResponse",
        "black box": "BlackBox",
    }
    expected = next(op for word, op in words.items() if word in name)
    if not compiled & set(words.values()) == {expected}:
        raise RuntimeError(
            f"{name}: compiled to {sorted(compiled)}, expected {expected}. Its row would mislead."
        )


def run(quick=False):
    """Print the table."""
    record = pmf.synthetic_earthquake(31.16, 0.02, random_seed=1940, pga=3.13)
    data = pmf.paper.measurements(record, multipliers=(1.0,), random_seed=0).values
    calls = {}
    for name, model in models(record, data).items():
        logp, point = model.compile_logp(), model.initial_point()
        check(name, logp)
        calls[name] = lambda logp=logp, point=point: logp(point)
    best = best_of_rounds(calls, rounds=3 if quick else 9)
    rows = [[name, *map(significant, (1e6 * s, s / best[FIRST]))] for name, s in best.items()]
    print(f"\n## One log-posterior through PyMC: 10 DOF, 10 sensors, N_D = {data.shape[1]}\n")
    print(table(["model", "us", "x fused"], rows), flush=True)
