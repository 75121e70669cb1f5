"""Whether a file is there and can be read."""

from pathlib import Path


def check_readable(path: Path) -> None:
    """Refuse folders, missing files and files that cannot be opened."""
    if path.is_dir():
        raise IsADirectoryError(f"`path` must be a file, got the folder {path}. Name a file in it.")
    if not path.exists():
        raise FileNotFoundError(
            f"`path` must be an existing file, got {path}. The current folder is {Path.cwd()}."
        )
    try:
        path.open("rb").close()
    except OSError as error:
        raise type(error)(f"`path` must be readable, got {path}: {error.strerror}.") from error
