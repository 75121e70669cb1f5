"""Exact answers that take long: quadrature up to five parameters, long chains and importance sampling above.

    python -m benchmarks.known.exact NAME... [--minutes 3]

Every posterior is written to `answers.json` as soon as it is done; those that are there are left out, unless
`--again` is given.
"""
