#!/usr/bin/env python3
"""Sessions of Monte Carlo truth by the independent generator, through `ssrig estimate`.

usage: held_back_truth.py SSRIG
Prints a Markdown table: mean error (rms a pixel) in percent over the pixels away from the border, with the surface, the
correspondence and the indirect light as the program finds them; blur of 0.5 px is given.
"""
import math
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor

TESTS = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
sys.path.insert(0, os.path.join(TESTS, "estimation", "held_back"))
import make_session  # noqa: E402
from make_session import gray, read_exr, stripes  # noqa: E402

TRUTH = os.path.join(TESTS, "data", "mc_truth_rf.csv")
SIZE = [27, 22]
BORDER_PX = 3
ERRORS = 255  # the bits of validity under which the maps hold NaN
SCENES = {"plane, 0 degrees": {"tilt_deg": 0}, "plane, 30 degrees": {"tilt_deg": 30},
          "plane, 60 degrees": {"tilt_deg": 60}, "sphere": {"shape": "sphere", "radius_mm": 60}}
INDIRECT = [0, 0.02, 0.1]


def mean_and_rms(errors):
    mean = sum(errors) / len(errors)
    return mean, math.sqrt(sum((e - mean) ** 2 for e in errors) / len(errors))


def row_of(job):
    ssrig, medium, scene, indirect, seed = job
    with tempfile.TemporaryDirectory(prefix="ssrig_truth_") as session:
        truth = make_session.make(session, format="Mono16", size=SIZE, indirect=indirect, blur_px=0.5,
                                  transfer="list", seed=seed, monte_carlo=(TRUTH, [medium]),
                                  patterns=stripes("column", 40, 8, range(40)) + gray("column", 10) +
                                  stripes("column", 16, 8, range(0, 16, 4)), **SCENES[scene])
        done = subprocess.run([ssrig, "estimate", session, "--model", "monte_carlo", "--threads", "1"],
                              capture_output=True, text=True)
        if done.returncode:
            return "| %s | %s | %g | %s |" % (medium, scene, indirect, done.stderr.strip())
        maps = {name: read_exr(os.path.join(session, "maps", name + ".exr"))[0]
                for name in ("sigma_a", "sigma_s_prime", "validity", "correspondence")}
    width, height = SIZE
    errors = {"sigma_a": [], "sigma_s_prime": []}
    squares = count = seen = 0
    for i in range(width * height):
        row, col = divmod(i, width)
        inside = BORDER_PX <= row < height - BORDER_PX and BORDER_PX <= col < width - BORDER_PX
        if not inside or truth["z"][i] is None:
            continue
        seen += 1
        if int(maps["validity"]["Y"][i]) & ERRORS:
            continue
        count += 1
        for name, own in errors.items():
            own.append(100 * (maps[name]["Y"][i] / truth["bands"][0][name] - 1))
        squares += (maps["correspondence"]["U"][i] - truth["u"][i]) ** 2
    return "| %s | %s | %g | %+.2f (%.2f) | %+.2f (%.2f) | %.3f | %.0f |" % (
        medium, scene, indirect, *mean_and_rms(errors["sigma_a"]), *mean_and_rms(errors["sigma_s_prime"]),
        math.sqrt(squares / count), 100 * count / seen)


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    jobs = [(sys.argv[1], medium, scene, indirect) for medium in make_session.EXIT_RADIANCE
            for scene in SCENES for indirect in INDIRECT]
    print("| truth | scene | B | sigma_a | sigma_s' | u rms, px | valid % |\n|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(2) as pool:
        for row in pool.map(row_of, [job + (1000 + n,) for n, job in enumerate(jobs)]):
            print(row, flush=True)


if __name__ == "__main__":
    main()
