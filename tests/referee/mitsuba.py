#!/usr/bin/env python3
"""Holds `tessera render` to Mitsuba 3: direct light on diffuse surfaces, which both describe exactly.

    python3 -m venv venv && venv/bin/pip install mitsuba==3.9.1 OpenEXR==3.5.3 numpy
    TESSERA_SCENES=FOLDER venv/bin/python tests/referee/mitsuba.py [--size 512] [--keep FOLDER]

Scenes: the Cornell box (`cornell_box/cornell_box.obj` in $TESSERA_SCENES; left out, and said, without it), and a torus knot of 32,768 flat
triangles on a floor, made here. Each is lit by two point lights and a distant one, one after the other and all together, and seen through
the centres of the pixels. Exit code 1 beyond the bounds that README.md derives. `--keep` leaves pictures there; `--tessera PROGRAM` names
the program, by default target/debug/tessera or $TESSERA.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

# This file is named like the module, which must not find it first.
sys.path = [p for p in sys.path if Path(p or ".").resolve() != Path(__file__).resolve().parent]

import mitsuba as mi
import numpy as np
import OpenEXR

mi.set_variant("scalar_rgb")

# Of the distance from the eye, where both see the same triangle: derived, like what follows, in README.md.
DISTANCE_BOUND = 2e-6
# Of the radiance at normal incidence, times 1 + the distance from the eye to that from the light: 3 distances and 16 roundings of f32.
RADIANCE_BOUND = 3 * DISTANCE_BOUND + 16 * 2.0**-24
# Of the pixels: those that see another triangle, and those that see another shadow.
TRIANGLE_BOUND = 1e-4
SHADOW_BOUND = 2e-3
# Nothing is there.
MISS = 0xFFFFFFFF


class Part:
    """The triangles of one material."""

    def __init__(self, color):
        self.color = color
        self.vertices = []
        self.triangles = []


def cornell(folder):
    """Parts of the Cornell box, its file, camera and lights."""
    source = folder / "cornell_box/cornell_box.obj"
    colors = {"white": (0.75, 0.75, 0.75), "red": (0.6, 0.05, 0.05), "green": (0.1, 0.5, 0.1)}
    vertices, parts, name = [], {}, None
    for line in source.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(w) for w in words[1:4]])
        elif words[:1] == ["usemtl"]:
            name = words[1]
        elif words[:1] == ["f"]:
            corners = [int(w.split("/")[0]) for w in words[1:]]
            corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
            part = parts.setdefault(name, Part(colors[name]))
            for second, third in zip(corners[1:], corners[2:]):
                part.triangles.append([len(part.vertices) + i for i in range(3)])
                part.vertices += [vertices[c] for c in (corners[0], second, third)]
    camera = dict(eye=(278.0, 273.0, -800.0), target=(278.0, 273.0, 0.0), fov=39.0)
    lights = [
        dict(kind="point", position=(278.0, 500.0, 250.0), color=(1.0, 0.9, 0.75), intensity=300000.0),
        dict(kind="point", position=(100.0, 350.0, -200.0), color=(0.5, 0.7, 1.0), intensity=100000.0),
        dict(kind="directional", direction=(0.3, -0.5, 0.8), color=(1.0, 1.0, 1.0), intensity=1.5),
    ]
    return source, parts, camera, lights


def knot(folder):
    """A torus knot on a floor: written as an OBJ file without normals, and the rest as above."""
    along, around = 512, 32
    t = np.linspace(0, 2 * np.pi, along, endpoint=False)
    curve = lambda t: np.stack(
        [(2 + np.cos(3 * t)) * np.cos(2 * t), np.sin(3 * t) + 1.6, (2 + np.cos(3 * t)) * np.sin(2 * t)], axis=-1
    )
    tangent = curve(t + 1e-4) - curve(t - 1e-4)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    upward = np.cross(side, tangent)
    turn = np.linspace(0, 2 * np.pi, around, endpoint=False)[None, :, None]
    tube = curve(t)[:, None] + 0.45 * (np.cos(turn) * side[:, None] + np.sin(turn) * upward[:, None])
    tube = tube.reshape(-1, 3).astype(np.float32)
    i, j = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")
    corner = lambda di, dj: ((i + di) % along * around + (j + dj) % around).ravel()
    a, b, c, d = corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)
    faces = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    parts = {"knot": Part((0.7, 0.45, 0.2)), "floor": Part((0.6, 0.6, 0.65))}
    parts["knot"].vertices, parts["knot"].triangles = tube.tolist(), faces.tolist()
    parts["floor"].vertices = [[-8.0, 0.0, -8.0], [8.0, 0.0, -8.0], [8.0, 0.0, 8.0], [-8.0, 0.0, 8.0]]
    parts["floor"].triangles = [[0, 2, 1], [0, 3, 2]]
    lines, base = ["mtllib knot.mtl"], 1
    for name, part in parts.items():
        lines.append(f"usemtl {name}")
        lines += ["v " + " ".join(repr(float(x)) for x in v) for v in part.vertices]
        lines += ["f " + " ".join(str(base + c) for c in f) for f in part.triangles]
        base += len(part.vertices)
    source = folder / "knot.obj"
    source.write_text("\n".join(lines) + "\n")
    (folder / "knot.mtl").write_text("".join(f"newmtl {name}\n" for name in parts))
    camera = dict(eye=(3.0, 6.0, 7.0), target=(0.0, 1.3, 0.0), fov=40.0)
    lights = [
        dict(kind="point", position=(4.0, 7.0, 2.0), color=(1.0, 0.9, 0.7), intensity=120.0),
        dict(kind="point", position=(-5.0, 3.0, 4.0), color=(0.4, 0.6, 1.0), intensity=60.0),
        dict(kind="directional", direction=(0.4, -1.0, -0.6), color=(1.0, 1.0, 1.0), intensity=0.8),
    ]
    return source, parts, camera, lights


def numbers(values):
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"


def ours(tessera, folder, name, scene, lights, size, more=("--plain",)):
    """Renders with Tessera; channels of its EXR file."""
    source, parts, camera, _ = scene
    text = [f'source = "{source}"', 'normals = "flat"']
    text += ["[[camera]]", 'name = "c"', f"eye = {numbers(camera['eye'])}", f"target = {numbers(camera['target'])}"]
    text += [f"fov = {camera['fov']}"]
    for light in lights:
        text += ["[[light]]", f'kind = "{light["kind"]}"', f"color = {numbers(light['color'])}"]
        text += [f"intensity = {light['intensity']}"]
        text += [f"{key} = {numbers(light[key])}" for key in ("position", "direction") if key in light]
    for part, content in parts.items():
        text += [f'[material."{part}"]', f"base_color = {numbers(content.color)}", "metallic = 0.0", "roughness = 1.0"]
        text += ["specular = [0.0, 0.0, 0.0]", "double_sided = true"]
    file, out = folder / f"{name}.toml", folder / f"{name}.exr"
    file.write_text("\n".join(text) + "\n")
    command = [tessera, "render", str(file), "--out", str(out), "--size", f"{size}x{size}", "--backend", "cpu", "--json"]
    subprocess.run(command + list(more), check=True, stdout=subprocess.DEVNULL)
    return OpenEXR.File(str(out), separate_channels=True).channels()


def write_ply(path, part):
    vertices, faces = np.array(part.vertices, "<f4"), np.array(part.triangles, "<i4")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    header += "property float x\nproperty float y\nproperty float z\n"
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(faces), dtype=[("n", "u1"), ("v", "<i4", 3)])
    rows["n"], rows["v"] = 3, faces
    path.write_bytes(header.encode() + vertices.tobytes() + rows.tobytes())


def theirs(folder, scene, lights, size):
    """Renders with Mitsuba: radiance, hit points, normals, and a number for each triangle."""
    _, parts, camera, _ = scene
    # One sample, which is not moved about in its pixel, in a box as wide as the pixel: the ray through the centre.
    film = dict(type="hdrfilm", width=size, height=size, rfilter=dict(type="box"), pixel_format="rgb")
    # The near plane is where their rays begin.
    span = float(np.linalg.norm(np.subtract(camera["eye"], camera["target"])))
    world = {
        "type": "scene",
        "integrator": {
            "type": "aov",
            "aovs": "p:position,n:geo_normal,t:prim_index,s:shape_index",
            "image": dict(type="direct", emitter_samples=1, bsdf_samples=0),
        },
        "sensor": dict(
            type="perspective",
            fov=camera["fov"],
            fov_axis="y",
            near_clip=span * 1e-3,
            far_clip=span * 1e3,
            to_world=mi.ScalarTransform4f().look_at(origin=camera["eye"], target=camera["target"], up=[0, 1, 0]),
            film=film,
            sampler=dict(type="stratified", sample_count=1, jitter=False),
        ),
    }
    for i, (name, part) in enumerate(parts.items()):
        path = folder / f"part-{i}.ply"
        write_ply(path, part)
        color = dict(type="rgb", value=list(part.color))
        surface = dict(type="twosided", bsdf=dict(type="diffuse", reflectance=color))
        world[f"part{i}"] = dict(type="ply", filename=str(path), face_normals=True, bsdf=surface)
    for i, light in enumerate(lights):
        strength = dict(type="rgb", value=[light["intensity"] * c for c in light["color"]])
        if light["kind"] == "point":
            world[f"light{i}"] = dict(type="point", position=list(light["position"]), intensity=strength)
        else:
            world[f"light{i}"] = dict(type="directional", direction=list(light["direction"]), irradiance=strength)
    image = np.array(mi.render(mi.load_dict(world), spp=1))
    radiance, points, normals = image[..., :3], image[..., 3:6], image[..., 6:9]
    hit = np.any(normals != 0, axis=-1)
    triangle = image[..., 9].astype(np.int64) + (image[..., 10].astype(np.int64) << 32)
    return radiance.astype(np.float64), points.astype(np.float64), hit, np.where(hit, triangle, -1)


def same_triangles(ids, triangles):
    """Where both see one triangle: their numbers are paired by what most pixels say, and no number may have two partners."""
    pairs, counts = np.unique(np.stack([ids.ravel(), triangles.ravel()]), axis=1, return_counts=True)
    partner, taken = {}, set()
    for at in np.argsort(-counts):
        mine, other = pairs[:, at]
        if mine not in partner and other not in taken:
            partner[mine] = other
            taken.add(other)
    lookup = np.vectorize(lambda mine: partner.get(mine, -2))
    return lookup(ids) == triangles


def at_an_edge(mask):
    """Pixels of which some neighbour is different."""
    padded = np.pad(mask, 1, mode="edge")
    size = mask.shape[0]
    near = [padded[1 + dy : 1 + dy + size, 1 + dx : 1 + dx + size] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    return np.any([part != mask for part in near], axis=0)


def judge(name, make, options, work):
    """Compares both renderers on one scene; whether they agree."""
    size, fine = options.size, True
    scene = make(work if make is knot else options.scenes)
    _, parts, camera, lights = scene
    pixels = size * size
    say = lambda text: print(f"{name:8} {text}")
    sum_ours, sum_theirs, scale_sum, shadow_any = 0.0, 0.0, 0.0, np.zeros((size, size), bool)
    for i, light in enumerate(lights):
        mine = ours(options.tessera, work, f"{name}-{i}", scene, [light], size)
        other, points, hit, triangles = theirs(work, scene, [light], size)
        picture = np.stack([mine[c].pixels for c in "RGB"], -1).astype(np.float64)
        ids = mine["id.triangle"].pixels.astype(np.int64)
        same = same_triangles(np.where(ids == MISS, -1, ids), triangles)
        if i == 0:
            others = np.count_nonzero(~same)
            depth = mine["depth.Z"].pixels.astype(np.float64)
            distance = np.linalg.norm(points - np.array(camera["eye"]), axis=-1)
            seen = same & hit
            far = np.max(np.abs(depth[seen] - distance[seen]) / distance[seen])
            say(f"{size} x {size} pixels, {sum(len(p.triangles) for p in parts.values())} triangles, {np.count_nonzero(hit)} pixels hit one")
            say(f"another triangle in {others} pixels ({others / pixels:.2e}, bound {TRIANGLE_BOUND:.0e}); distances within {far:.1e} (bound {DISTANCE_BOUND:.0e})")
            fine &= others <= TRIANGLE_BOUND * pixels and bool(far <= DISTANCE_BOUND)

        # What the light would send back straight on, and how much more it matters to it where the point is than to the eye.
        albedo = np.zeros((size, size, 3))
        shape = triangles >> 32
        order = {s: p.color for s, p in zip(sorted(set(shape[hit].ravel())), parts.values())}
        for s, color in order.items():
            albedo[(shape == s) & hit] = color
        strength = light["intensity"] * np.array(light["color"])
        if light["kind"] == "point":
            way = np.linalg.norm(points - np.array(light["position"]), axis=-1)
            strength = strength / np.maximum(way, 1e-30)[..., None] ** 2
            leverage = 1 + np.linalg.norm(points - np.array(camera["eye"]), axis=-1) / np.maximum(way, 1e-30)
        else:
            leverage = np.ones((size, size))
        scale = np.max(albedo * strength / np.pi, axis=-1) * leverage

        # Lit by one and dark in the other beyond rounding: a shadow.
        error = np.max(np.abs(picture - other), axis=-1)
        dark = [np.max(p, axis=-1) == 0 for p in (picture, other)]
        shadow = same & hit & (dark[0] != dark[1]) & (error > RADIANCE_BOUND * scale)
        at_edge = shadow & (at_an_edge(dark[0]) | at_an_edge(dark[1]))
        compared = same & hit & ~shadow
        relative = error[compared] / scale[compared]
        lit = ~dark[0] & ~dark[1] & compared
        ratio = np.sum(picture[lit]) / np.sum(other[lit])
        say(
            f"light {i}, {light['kind']}: {np.count_nonzero(lit)} pixels lit; greatest difference {np.max(relative):.1e} of its bound's"
            f" unit, rms {np.sqrt(np.mean(relative**2)):.1e} (bound {RADIANCE_BOUND:.1e}), sum of ours / theirs {ratio:.8f};"
            f" another shadow in {np.count_nonzero(shadow)} pixels, {np.count_nonzero(at_edge)} of them at a shadow's edge"
        )
        only_ours = np.count_nonzero(shadow & dark[0])
        say(f"         dark in ours alone {only_ours}, in theirs alone {np.count_nonzero(shadow) - only_ours} (bound {SHADOW_BOUND:.0e} together)")
        fine &= bool(np.max(relative) <= RADIANCE_BOUND)
        fine &= np.count_nonzero(shadow) <= SHADOW_BOUND * pixels
        sum_ours, sum_theirs, scale_sum = sum_ours + picture, sum_theirs + other, scale_sum + scale
        shadow_any |= shadow

    # All lights at once add up.
    mine = ours(options.tessera, work, f"{name}-all", scene, lights, size)
    picture = np.stack([mine[c].pixels for c in "RGB"], -1).astype(np.float64)
    compared = same & hit & ~shadow_any
    together = np.max(np.abs(picture - sum_theirs), axis=-1)[compared] / scale_sum[compared]
    say(f"all lights together: greatest difference {np.max(together):.1e}")
    fine &= bool(np.max(together) <= RADIANCE_BOUND)

    # The quantised mesh moves vertices by up to half a voxel: said, not judged.
    packed = ours(options.tessera, work, f"{name}-packed", scene, lights, size, more=())
    moved = np.stack([packed[c].pixels for c in "RGB"], -1).astype(np.float64)
    peak = np.quantile(sum_theirs, 0.999)
    db = lambda a: 10 * np.log10(peak**2 / np.mean((a - sum_theirs) ** 2))
    say(f"whole picture, edges too: {db(picture):.1f} dB; with the quantised mesh {db(moved):.1f} dB (peak: the 99.9 % quantile)")
    say("agrees" if fine else "DOES NOT AGREE")
    if options.keep:
        code = lambda p: mi.Bitmap((np.clip(p / peak, 0, 1)).astype(np.float32)).convert(
            mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True
        )
        code(picture).write(str(options.keep / f"{name}-tessera.png"))
        code(sum_theirs).write(str(options.keep / f"{name}-mitsuba.png"))
        code(np.abs(picture - sum_theirs)).write(str(options.keep / f"{name}-difference.png"))
    return fine


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = Path(__file__).resolve().parents[2]
    options.add_argument("--tessera", default=os.environ.get("TESSERA", str(root / "target/debug/tessera")))
    options.add_argument("--scenes", type=Path, default=os.environ.get("TESSERA_SCENES"))
    options.add_argument("--size", type=int, default=512)
    options.add_argument("--keep", type=Path)
    options = options.parse_args()
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    print(f"Mitsuba {mi.__version__}, {mi.variant()}")
    with tempfile.TemporaryDirectory() as folder:
        work, results = Path(folder), []
        if options.scenes and (Path(options.scenes) / "cornell_box/cornell_box.obj").is_file():
            options.scenes = Path(options.scenes).resolve()
            results.append(judge("cornell", cornell, options, work))
        else:
            print("cornell  skipped: no cornell_box/cornell_box.obj under TESSERA_SCENES")
        results.append(judge("knot", knot, options, work))
    sys.exit(0 if all(results) else 1)


if __name__ == "__main__":
    main()
