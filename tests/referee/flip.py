#!/usr/bin/env python3
"""Holds `tessera compare`'s FLIP to the program of FLIP's authors (BSD-3-Clause).

    python3 -m venv venv && venv/bin/pip install flip-evaluator==1.7 numpy
    venv/bin/python tests/referee/flip.py                    the patterns of the test in master/src/compare
    venv/bin/python tests/referee/flip.py A.png B.png        any two pictures of 8 bits

Prints the mean of both programs and how far their maps differ; exit code 1 if that is beyond rounding. `--tessera PROGRAM` names the
program, by default target/debug/tessera or $TESSERA.
"""

import argparse
import json
import os
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import flip_evaluator
import numpy as np

# Theirs computes in f32. Most sensitive is a pixel whose colours c differ where no feature does: a roundoff n of 2^-23 that two features
# are apart makes a feature difference f = (n / sqrt(2))^0.5 of 2.9e-4, and c^(1 - f) is off by f c ln(1 / c), at most f / e. If all
# pixels were such, the mean would be off by as much. (Pictures of squares have many: there it is 5e-6, and at most 9.5e-5 a pixel.)
MEAN_BOUND = (2.0**-23 / 2**0.5) ** 0.5 / 2.718
# Colours of magma that lie side by side differ by at most 3 codes.
MAP_BOUND = 3


def patterns():
    """Pairs of pictures as the test makes them."""
    y, x, c = np.meshgrid(np.arange(64), np.arange(96), np.arange(3), indexing="ij")
    ramp = (x * 7 + y * 13 + c * 50) % 256
    yield "ramps", ramp, ramp + (c + 1) * (x * y % 11 - 5)
    squares = lambda shift: ((x + shift) // 8 + y // 8) % 2 * (255 - 60 * c)
    yield "squares", squares(0), squares(1)
    smooth = 40 + (3 * x + 2 * y + 40 * c) // 4
    yield "noise", smooth, smooth + (x * x * 31 + y * y * 17 + x * y * 7 + c * 101) % 23 - 11
    yield "primaries", 255 * (c == 1), 255 * (c == 2)


def write_png(path, codes):
    """An RGB PNG of 8 bits."""
    codes = np.clip(codes, 0, 255).astype(np.uint8)
    height, width, _ = codes.shape
    rows = b"".join(b"\0" + row.tobytes() for row in codes)
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def agree(tessera, name, a, b, folder):
    """Compares both programs on two files."""
    drawn = folder / "map.png"
    command = [tessera, "compare", str(a), str(b), "--json", "--map", str(drawn)]
    ours = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["flip"]
    theirs, mean, _ = flip_evaluator.evaluate(str(a), str(b), "LDR")
    codes = lambda picture: np.rint(np.asarray(picture) * 255)
    map_error = np.abs(codes(theirs) - codes(flip_evaluator.load(str(drawn)))).max()
    # Their mean is a sum of f32; its terms in f64 are the better figure.
    errors, _, _ = flip_evaluator.evaluate(str(a), str(b), "LDR", applyMagma=False)
    exact = np.asarray(errors, dtype=np.float64).mean()
    fine = abs(ours - exact) <= MEAN_BOUND and map_error <= MAP_BOUND
    print(f"{name:12} ours {ours:.9f}  theirs {exact:.9f} (as they print it {mean:.6f})  difference {ours - exact:+.1e}"
          f"  maps within {map_error:.0f} codes  {'ok' if fine else 'TOO FAR'}")
    return fine


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("pictures", nargs="*", type=Path)
    root = Path(__file__).resolve().parents[2]
    options.add_argument("--tessera", default=os.environ.get("TESSERA", str(root / "target/debug/tessera")))
    options = options.parse_args()
    if len(options.pictures) not in (0, 2):
        sys.exit("name two pictures, or none")
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        pairs = [(f"{options.pictures[0].name}", *options.pictures)] if options.pictures else []
        for name, a, b in patterns() if not pairs else []:
            files = [folder / f"{name}-{side}.png" for side in "ab"]
            write_png(files[0], a)
            write_png(files[1], b)
            pairs.append((name, *files))
        results = [agree(options.tessera, *pair, folder) for pair in pairs]
    sys.exit(0 if all(results) else 1)


if __name__ == "__main__":
    main()
