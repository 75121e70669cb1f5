"""Writing an example to a folder."""

from pathlib import Path

from pymc_features.storage import write_atomically
from pymc_features.update.config.keys import SCHEMA
from pymc_features.update.examples import EXAMPLES
from pymc_features.update.templates import TEMPLATES


def write_example(path, *, example: str = "shaking-table", synthetic: bool = False) -> tuple[list[Path], str]:
    """Write a commented configuration that runs as it is.

    Parameters
    ----------
    path : path
        Where; nothing there is overwritten.
    example : {"shaking-table", "building"}
        Three storeys with the measured data of a shaking table, if they can be had, else simulated ones; or
        a building of eight storeys with three sensors, simulated under El Centro 1940, whose true parameters
        the file states.
    synthetic : bool
        Do not look for the shaking table's data.

    Returns
    -------
    list of Path, str
        Files written, the configuration first, its JSON schema, by which editors check keys, last.
    str
        Which data they use, and why.

    Raises
    ------
    ValueError
        If there is no such example, or `synthetic` is asked of one whose data always are.
    FileExistsError, FileNotFoundError
        If a file is in the way, or the folder is missing.
    """
    path = Path(path)
    measured = path.with_name(f"{path.stem}-measured.csv")
    if example not in EXAMPLES:
        raise ValueError(f"`example` must be one of {', '.join(EXAMPLES)}, got {example!r}.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"`CONFIG` must be in an existing folder, got {path.parent}.")
    template, values, channels, sentence = EXAMPLES[example](measured.name, synthetic)
    schema = path.with_name(f"{path.stem}.schema.json")
    lines = f"#:schema ./{schema.name}\n{TEMPLATES.get_template(template).render(values)}"
    texts = {path: lines}
    if channels:
        texts[measured] = channels
    for file in texts:
        if file.exists():
            raise FileExistsError(f"`CONFIG` must be a new file, got {file}. Choose another name.")
    texts[schema] = SCHEMA.read_text(encoding="utf-8")  # which may be there, of another configuration
    for file, text in reversed(texts.items()):  # the configuration last, which names the other
        write_atomically(file, lambda p, text=text: p.write_text(text, encoding="utf-8"))
    return list(texts), sentence
