#!/usr/bin/env python3
"""A rig calibrated and used as an operator does it, over all the wires of ssrig-sim, and held against the truth.

usage: tests/bench/calibration_live.py BUILD_FOLDER [--poses 15] [--scene face_female] [--keep FOLDER]

Runs `ssrig calibrate geometry`, `ssrig calibrate radiometry` and `ssrig capture` against one virtual rig (config/simulated.toml
with blur, defocus, projector black and a lit room), each answered by its Enter keys; then estimates the same face's frames
once more with the true calibration. Prints the calibration's errors and the maps' errors with either, as tables. About ten
minutes; exits 1 where a figure misses its target.
"""
import argparse
import json
import math
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
BLUR_PX, FOCUS_MM, DEFOCUS_PX_PER_MM, BLACK_FRAC = 0.7, 1030.0, 0.005, 0.002
EFFECTS = f"""[projector]
blur_px = {BLUR_PX}
focus_mm = {FOCUS_MM}
defocus_px_per_mm = {DEFOCUS_PX_PER_MM}
black_frac = {BLACK_FRAC}
"""


def write_rigs(folder):
    toml = (ROOT / "config/simulated.toml").read_text()
    toml = toml.replace("127.43.0.1", "127.43.21.1").replace("SIM0001", "SIM0021")
    toml += f'\n[storage]\ndirectory = "{folder}/sessions"\n[daemon]\nport = 8661\n'
    true_file = ROOT / "config/simulated_calibration.json"
    (folder / "sim.toml").write_text(toml.replace("simulated_calibration.json", str(true_file)))
    (folder / "rig.toml").write_text(toml.replace("simulated_calibration.json", "calibration.json"))
    (folder / "effects.toml").write_text(EFFECTS)
    return json.loads(true_file.read_text())


def run(folder, binaries, scene, command, answers=""):
    start = time.time()
    argv = [binaries / "ssrig-sim", "run", "--rig", folder / "sim.toml", "--scene", scene, "--effects",
            folder / "effects.toml", "--", binaries / "ssrig", *command]
    done = subprocess.run([str(word) for word in argv], input=answers, text=True, capture_output=True, check=False)
    (folder / f"{command[0]}_{command[1]}.log".replace("--", "")).write_text(done.stdout + done.stderr)
    if done.returncode != 0:
        sys.exit(f"{' '.join(str(word) for word in command)} ended with {done.returncode}:\n{done.stderr[-2000:]}")
    return time.time() - start


def angle_deg(a, b):
    trace = sum(a[i][k] * b[i][k] for i in range(3) for k in range(3))
    sine = 0.0  # of the relative rotation's antisymmetric part: exact for small angles
    m = [[sum(a[i][k] * b[j][k] for k in range(3)) for j in range(3)] for i in range(3)]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        sine += (m[i][j] - m[j][i]) ** 2 / 4
    return math.degrees(math.atan2(math.sqrt(sine), (trace - 1) / 2))


def contrast(n, blur_px):
    k = 2 * math.pi * n / 40
    return math.exp(-k * k * blur_px * blur_px / 2)


def blur_at(distance_mm):
    return math.hypot(BLUR_PX, DEFOCUS_PX_PER_MM * (distance_mm - FOCUS_MM))


def undistorted(lens, px):
    """Normalised coordinates of a pixel, by fixed-point iteration (distortions here are small)."""
    k = lens["K"]
    k1, k2, p1, p2, k3 = lens.get("distortion", [0] * 5)
    xd, yd = (px[0] - k[0][2]) / k[0][0], (px[1] - k[1][2]) / k[1][1]
    x, y = xd, yd
    for _ in range(50):
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x, y = ((xd - 2 * p1 * x * y - p2 * (r2 + 2 * x * x)) / radial,
                (yd - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y) / radial)
    return x, y


def along(matrix, vector):
    return [sum(row[i] * vector[i] for i in range(3)) for row in matrix]


def triangulated(calibration, camera_px, projector_px):
    """The point on the camera's ray that agrees best with column and row."""
    x, y = undistorted(calibration["camera"], camera_px)
    seen = undistorted(calibration["projector"], projector_px)
    turned, t = along(calibration["projector"]["R"], (x, y, 1)), calibration["projector"]["t"]
    pairs = [(turned[i] - seen[i] * turned[2], seen[i] * t[2] - t[i]) for i in range(2)]
    depth = sum(a * b for a, b in pairs) / sum(a * a for a, _ in pairs)
    return x * depth, y * depth, depth


def plane_errors(found, truth, tilt_deg):
    """Of a plane through (0, 0, 1000) mm as the true rig reads it: rms off its place, rms off the best plane."""
    normal = (math.sin(math.radians(tilt_deg)), 0, math.cos(math.radians(tilt_deg)))
    places, points = [], []
    for row in range(20, 432, 20):
        for col in range(20, 588, 20):
            x, y = undistorted(truth["camera"], (col, row))
            depth = 1000 * normal[2] / (normal[0] * x + normal[2])
            lit = along(truth["projector"]["R"], (x * depth, y * depth, depth))
            lit = [a + b for a, b in zip(lit, truth["projector"]["t"])]
            lit = [value / lit[2] for value in along(truth["projector"]["K"], lit)]
            if not (0 <= lit[0] <= 1023 and 0 <= lit[1] <= 767):
                continue
            point = triangulated(found, (col, row), lit)
            places.append(sum(n * (p - q) for n, p, q in zip(normal, point, (0, 0, 1000))))
            points.append(point)
    # Distance from the true plane, less its best linear part: a small tilt and shift.
    design = [(1, p[0] / 100, p[1] / 100) for p in points]
    moments = [[sum(d[i] * d[j] for d in design) for j in range(3)] for i in range(3)]
    right = [sum(d[i] * e for d, e in zip(design, places)) for i in range(3)]
    for i in range(3):  # Gauss and Jordan; the moments are well conditioned
        scale = moments[i][i]
        moments[i] = [m / scale for m in moments[i]]
        right[i] /= scale
        for j in range(3):
            if j != i:
                factor = moments[j][i]
                moments[j] = [a - factor * b for a, b in zip(moments[j], moments[i])]
                right[j] -= factor * right[i]
    left = [e - sum(c * v for c, v in zip(right, d)) for d, e in zip(design, places)]

    def rms(values):
        return math.sqrt(sum(v * v for v in values) / len(values))

    return rms(places), rms(left)


def true_session(session, truth, folder):
    """The same frames with the calibration that the simulator was made with."""
    copy = folder / "with_truth"
    shutil.copytree(session, copy, ignore=shutil.ignore_patterns("maps", "report"))
    manifest = json.loads((copy / "session.json").read_text())
    calibration = json.loads(json.dumps(truth))
    calibration["projector_black"] = [BLACK_FRAC * s for s in truth["irradiance"]["signal_per_us"]]
    calibration["stripe_transfer"] = [
        {"distance_mm": d, "transfer": [contrast(n, blur_at(d)) for n in range(1, 41)]} for d in range(880, 1241, 10)]
    manifest["calibration"] = calibration
    (copy / "session.json").write_text(json.dumps(manifest))
    return copy


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--poses", type=int, default=15)
    parser.add_argument("--scene", default="face_female")
    parser.add_argument("--keep", type=pathlib.Path, help="work in this folder and leave it")
    arguments = parser.parse_args()
    binaries = arguments.build.resolve() / "bin"
    folder = arguments.keep.resolve() if arguments.keep else pathlib.Path(tempfile.mkdtemp(prefix="calibration."))
    folder.mkdir(parents=True, exist_ok=True)
    truth = write_rigs(folder)
    rig = ["--rig", folder / "rig.toml"]

    geometry_s = run(folder, binaries, "board",
                     ["calibrate", "geometry", *rig, "--board", "checkerboard", "10x13", "15"],
                     "\n" * arguments.poses + "q\n")
    radiometry_s = run(folder, binaries, "standard", ["calibrate", "radiometry", *rig, "--reflectance", "0.99"],
                       "\n" * 6)
    found = json.loads((folder / "calibration.json").read_text())
    of = found["calibrated"]
    turned = angle_deg(found["projector"]["R"], truth["projector"]["R"])
    shifted = math.dist(found["projector"]["t"], truth["projector"]["t"])
    scale = (found["irradiance"]["reference_distance_mm"] / truth["irradiance"]["reference_distance_mm"]) ** 2
    signal = max(abs(a * scale / b - 1) for a, b in zip(found["irradiance"]["signal_per_us"],
                                                        truth["irradiance"]["signal_per_us"]))
    gain = of["radiometry"]["sensor"]["gain_e_per_dn"]["value"] / 4.88 - 1
    noise = of["radiometry"]["sensor"]["read_noise_e"]["value"] / 10 - 1
    blur = 0
    for entry in found["stripe_transfer"]:
        for curve in entry["transfer"].values() if isinstance(entry["transfer"], dict) else [entry["transfer"]]:
            m = curve[3]  # n = 4 tells blur best
            blur = max(blur, abs(math.sqrt(-2 * math.log(m)) * 40 / (2 * math.pi * 4) - blur_at(entry["distance_mm"])))
    stated = of["geometry"]
    planes = [(tilt, *plane_errors(found, truth, tilt)) for tilt in (0, 30)]
    rows = [("reprojection, camera", of["geometry"]["camera_rms_px"], 0.2, "px rms"),
            ("reprojection, projector", of["geometry"]["projector_rms_px"], 0.2, "px rms"),
            ("rotation", turned, 0.05, "degrees"), ("translation", shifted, 0.3, "mm"),
            ("rotation, of its stated standard deviation", turned / stated["rotation_sd_deg"], 1.5, ""),
            ("translation, likewise", shifted / stated["translation_sd_mm"], 1.5, ""),
            *((f"plane turned by {tilt} degrees: {what}", value, 0.1, "mm rms")
              for tilt, place, flat in planes for what, value in (("off its place", place), ("not flat", flat))),
            ("signal_per_us", 100 * signal, 0.5, "%"), ("gain", 100 * abs(gain), 0.5, "%"),
            ("read noise", 100 * abs(noise), 0.5, "%"), ("blur, worst of distances and bands", blur, 0.1, "px")]
    print(f"{arguments.poses} poses in {geometry_s:.0f} s, the radiometric series in {radiometry_s:.0f} s\n")
    print("| off by | value | asked |\n| --- | --- | --- |")
    for name, value, limit, unit in rows:
        print(f"| {name} | {value:.4f} {unit} | {limit} |")

    run(folder, binaries, arguments.scene, ["capture", *rig, "--subject", "face", "--model", "monte_carlo_angular"])
    session = next((folder / "sessions").glob("*-face"))
    exact = true_session(session, truth, folder)
    subprocess.run([binaries / "ssrig", "estimate", exact, "--model", "monte_carlo_angular"], check=True,
                   capture_output=True)
    for name, place in (("recovered", session), ("true", exact)):
        print(f"\nmaps with the {name} calibration:", flush=True)
        subprocess.run([binaries / "ssrig-sim", "judge", place], check=True)
    if not arguments.keep:
        shutil.rmtree(folder)
    sys.exit(0 if all(value <= limit for _, value, limit, _ in rows) else 1)


if __name__ == "__main__":
    main()
