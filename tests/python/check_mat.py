"""Checks a .mat of `inerter export` without MATLAB: that it is what MATLAB v7.3 asks for, and that the numbers are there.

    python check_mat.py RUN.mat RUN.parquet

The numbers must equal those of the Parquet file of the same export, to the bit.
"""

import sys

import h5py
import numpy
import pandas

mat, parquet = sys.argv[1:]
with open(mat, "rb") as file:
    head = file.read(128)
assert head.startswith(b"MATLAB 7.3 MAT-file"), head[:32]
assert head[124:128] == b"\x00\x02IM", "version and byte order of the header"

run = pandas.read_parquet(parquet)
with h5py.File(mat) as file:
    for name, column in run.items():
        data = file[name]
        assert data.attrs["MATLAB_class"] == b"double", name
        assert data.shape == (1, len(run)), f"{name} must be a column vector, stored the other way round"
        assert numpy.array_equal(data[0], column.to_numpy(dtype=float)), name
    for name in ["settings", "units", "device", "estimates"]:
        assert file[name].attrs["MATLAB_class"] == b"struct", name
    for name, value in run.attrs["settings"].items():
        assert file["settings"][name][0, 0] == value, name
    unit = file["units"]["force_n"]
    assert unit.attrs["MATLAB_class"] == b"char" and "".join(map(chr, unit[:, 0])) == "N"
    assert file["estimates"]["inertance_kg"].shape[0] == 1
print(f"{mat}: {len(run)} samples as MATLAB v7.3 wants them, equal to those of {parquet}")
