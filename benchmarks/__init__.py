"""What the package costs and how good its posteriors are, beside what others offer, measured in one run.

    python -m benchmarks [--only evaluation|gradients|posteriors|abc|scaling|structures] [--quick]
    python -m benchmarks --only dimensions|targets [--quick] [--names NAME...]

One thread everywhere: the limits below must be set before NumPy is imported for the first time.
"""

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR", "NUMBA"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()
os.environ.setdefault("JAX_PLATFORMS", "cpu")
