"""Settings of a simulator, checked before anything runs."""

from pymc_features.external.processes.executors import check_executor

RETURNS = ("response", "mean_square")


def check_simulator(function, shape, returns, gradient, version, surrogate, dt):
    """Refuse what cannot be used of a simulator."""
    for name, value in (("function", function), ("gradient", gradient)):
        if not callable(value) and not (name == "gradient" and value is None):
            raise TypeError(f"`{name}` must be callable, got {type(value).__name__}.")
    try:
        right = len(shape) == 2 and all(int(n) == n and n >= 1 for n in shape)
    except TypeError:
        right = False
    if not right:
        raise ValueError(f"`shape` must be (sensors, times) of the data, got {shape!r}. Pass data.shape.")
    if returns not in RETURNS:
        raise ValueError(f"`returns` must be one of {', '.join(RETURNS)}, got {returns!r}.")
    check_seconds("dt", dt)
    if gradient is not None and surrogate is not None:
        raise ValueError(
            "`gradient` must be left out with `surrogate`, got both: predictions have other derivatives. "
            "Sample with pmf.sample_smc()."
        )
    if not (version is None or isinstance(version, str)):
        raise TypeError(f"`version` must be a text, got {version!r}.")
    if not (surrogate is None or callable(getattr(surrogate, "evaluate", None))):
        raise TypeError(
            f"`surrogate` must be a Surrogate, got {type(surrogate).__name__}. Pass pmf.Surrogate(2) for EXP."
        )


def check_evaluation(timeout, retries, executor):
    """Refuse what cannot be used to run it."""
    check_seconds("timeout", timeout)
    if not (is_number(retries) and retries >= 0 and int(retries) == retries):
        raise ValueError(f"`retries` must be an integer of at least 0, got {retries!r}.")
    check_executor(executor)


def check_seconds(name, value):
    """Refuse a time that is given and not positive."""
    if value is not None and not (is_number(value) and 0 < value < float("inf")):
        raise ValueError(f"`{name}` must be a positive number of seconds, got {value!r}.")


def is_number(value) -> bool:
    """Whether a setting is a plain number."""
    return isinstance(value, int | float) and not isinstance(value, bool)
