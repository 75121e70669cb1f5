"""How large a number, how long a name and how deep a list may be: what is larger can be no setting."""

from pymc_features.exceptions import ConfigError

LARGEST = 2**63 - 1  # integers of TOML have 64 bits
DEEPEST = 16  # tables and lists within each other
LONGEST = 200  # characters of a key


def check_sizes(value, key: str = "", depth: int = 0) -> None:
    """Refuse what would only fail later, in a conversion, by a recursion or in a message without end."""
    if isinstance(value, int) and abs(value) > LARGEST:
        raise ConfigError(f"`{key}` must be a number of at most 64 bits, got one of {value.bit_length()}.")
    if not isinstance(value, dict | list):
        return
    if depth > DEEPEST:
        raise ConfigError(f"`{key}` must have at most {DEEPEST} tables or lists within each other, got more.")
    if isinstance(value, list):
        for number, item in enumerate(value):
            check_sizes(item, f"{key}[{number}]", depth + 1)
        return
    for name, item in value.items():
        if len(name) > LONGEST:
            at = f"`{key}`" if key else "the file"
            raise ConfigError(f"{at} must have keys of at most {LONGEST} characters, got {len(name)}.")
        check_sizes(item, f"{key}.{name}" if key else name, depth + 1)
