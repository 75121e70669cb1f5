"""MATLAB files of version 7.3, as MATLAB writes them."""

import h5py
import numpy as np


def save_v73(path, variables):
    """The layout MATLAB writes: a 512-byte preamble, transposed arrays, text as 16-bit codes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            if isinstance(value, str):
                item = file.create_dataset(name, data=np.array([[ord(c)] for c in value], dtype=np.uint16))
                item.attrs["MATLAB_class"] = np.bytes_("char")
            elif isinstance(value, dict):
                group = file.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key, field in value.items():
                    group.create_dataset(key, data=field)
            else:
                value = np.atleast_2d(value)
                item = file.create_dataset(name, data=value.T)
                kind = {"float64": "double", "float32": "single"}.get(value.dtype.name, value.dtype.name)
                item.attrs["MATLAB_class"] = np.bytes_(kind)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(512))
