"""Configurations that differ from the example of `write_example`."""

SIGMA = 'sigma = "sigma" '
SMALL = [
    ('kinds = ["CAL", "NORM", "TN", "EXP", "ABC"]', 'kinds = ["EXP", "ABC"]'),
    ("draws = 1000", "draws = 100"),
    ("chains = 2", "chains = 1"),
    ("# trim = [0.0, 10.0]", "trim = [0.0, 6.0]"),
]


def replaced(text, pairs):
    """Text with every old part, which must be there once, replaced by the new one."""
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def variant(example, tmp_path, *pairs):
    """The example changed, in a folder of its own beside the same data."""
    data = example.with_name("frame-measured.csv")
    path = tmp_path / "changed.toml"
    path.write_text(replaced(example.read_text(), [('"frame-measured.csv"', f'"{data}"'), *pairs]))
    return path
