"""Turns session_example/truth.npz into float32 files that the tests read without numpy.
usage: convert_truth.py TRUTH.npz OUT_FOLDER    (writes NAME.f32, row-major, channels interleaved)"""
import ast
import pathlib
import struct
import sys
import zipfile

KEEP = ["R_d", "l_d", "sigma_a", "sigma_s", "X", "N", "u", "bmap", "reg"]
CODE = {"<f8": "d", "<i8": "q"}


def read_npy(data):
    header_size = struct.unpack("<H", data[8:10])[0]
    header = ast.literal_eval(data[10:10 + header_size].decode())
    count = 1
    for size in header["shape"]:
        count *= size
    return struct.unpack(f"<{count}{CODE[header['descr']]}", data[10 + header_size:])


source, target = zipfile.ZipFile(sys.argv[1]), pathlib.Path(sys.argv[2])
target.mkdir(parents=True, exist_ok=True)
for name in KEEP:
    values = read_npy(source.read(name + ".npy"))
    (target / (name + ".f32")).write_bytes(struct.pack(f"<{len(values)}f", *values))
