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

# Half of an f32's last place, relatively.
ROUNDOFF = 2.0**-24
# How far a hit is off across its triangle, of its distance from the eye. Derived, like what follows, in README.md.
HIT_BOUND = 8 * ROUNDOFF
# Of the pixels: those that see another triangle, and those that see another shadow.
TRIANGLE_BOUND = 1e-4
SHADOW_BOUND = 2e-3
# Of the pixels: those whose shadow f64 says we have wrong, or that their rays' ends do not explain.
WRONG_BOUND = 2e-5
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
    """Renders with Mitsuba: radiance, hit points, triangles counted through all parts (-1: none), and their colours."""
    _, parts, camera, _ = scene
    # One sample, which is not moved about in its pixel, in a box as wide as the pixel: the ray through the centre.
    film = dict(type="hdrfilm", width=size, height=size, rfilter=dict(type="box"), pixel_format="rgb")
    # The near plane is where their rays begin.
    span = float(np.linalg.norm(np.subtract(camera["eye"], camera["target"])))
    world = {
        "type": "scene",
        "integrator": {
            "type": "aov",
            "aovs": "p:position,n:geo_normal,c:albedo,t:prim_index",
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
    radiance, points, normals, seen, number = np.split(image, [3, 6, 9, 12], axis=-1)
    hit = np.any(normals != 0, axis=-1)
    # Every part has a colour of its own; its triangles are counted from its first.
    colors = np.array([part.color for part in parts.values()])
    part = np.argmin(np.linalg.norm(seen[:, :, None] - colors, axis=-1), axis=-1)
    first = np.cumsum([0] + [len(p.triangles) for p in parts.values()])
    triangles = np.where(hit, first[part] + number[..., 0].astype(np.int64), -1)
    return radiance.astype(np.float64), points.astype(np.float64), triangles, np.where(hit[..., None], colors[part], 0)


def as_theirs(ids, triangles):
    """Our triangles by their numbers: paired by what most pixels say, and no number has two partners."""
    pairs, counts = np.unique(np.stack([ids.ravel(), triangles.ravel()]), axis=1, return_counts=True)
    partner, taken = {}, set()
    for at in np.argsort(-counts, kind="stable"):
        mine, other = pairs[:, at]
        if mine not in partner and other not in taken:
            partner[mine] = other
            taken.add(other)
    # One that is nowhere seen by both has no partner: -2.
    return np.vectorize(lambda mine: partner.get(mine, -2))(ids)


class Exact:
    """The truth in f64: every triangle is tried."""

    def __init__(self, parts, camera, size):
        corners = [np.float32(p.vertices).astype(np.float64)[np.array(p.triangles)] for p in parts.values()]
        self.corners = np.concatenate(corners)
        self.camera, self.size = camera, size
        edges = np.roll(self.corners, -1, axis=1) - self.corners
        cross = np.cross(edges[:, 0], edges[:, 1])
        double_area = np.linalg.norm(cross, axis=1)
        self.normals = cross / double_area[:, None]
        self.heights = double_area / np.max(np.linalg.norm(edges, axis=2), axis=1)
        self.extent = np.max(np.ptp(self.corners.reshape(-1, 3), axis=0))

    def rays(self, rows, columns):
        """Directions through the centres of pixels."""
        eye, target = np.array(self.camera["eye"]), np.array(self.camera["target"])
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        tangent = np.tan(np.radians(self.camera["fov"]) / 2)
        across = lambda i: ((2 * np.asarray(i) + 1) / self.size - 1)[..., None] * tangent
        ways = forward + across(columns) * right - across(rows) * np.cross(right, forward)
        return ways / np.linalg.norm(ways, axis=-1, keepdims=True)

    def points(self, directions, triangles):
        """Where rays from the eye meet the planes of triangles."""
        eye, normal = np.array(self.camera["eye"]), self.normals[triangles]
        t = np.sum((self.corners[triangles, 0] - eye) * normal, -1) / np.sum(directions * normal, -1)
        return eye + t[..., None] * directions

    def hits(self, origin, direction):
        """Distances along one ray, infinite where a triangle is missed (Moeller and Trumbore 1997)."""
        a, ab, ac = self.corners[:, 0], self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        p = np.cross(direction, ac)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / np.sum(ab * p, -1)
            u = np.sum((origin - a) * p, -1) * scale
            q = np.cross(origin - a, ab)
            v, t = np.sum(direction * q, -1) * scale, np.sum(ac * q, -1) * scale
        return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)

    def verdict(self, directions, ours, theirs):
        """Whose triangles are the first on their rays, where they differ."""
        eye, right = np.array(self.camera["eye"]), [0, 0]
        for row, column in np.argwhere(ours != theirs):
            t = self.hits(eye, directions[row, column])
            first = np.argmin(t) if np.min(t) < np.inf else -1
            right = [count + (whose[row, column] == first) for count, whose in zip(right, (ours, theirs))]
        return f"; the truth is with ours in {right[0]}, with theirs in {right[1]}" if np.any(ours != theirs) else ""

    def is_blocked(self, point, triangle, light, as_theirs=False):
        """Whether anything but its own triangle is between a point and a light; where Mitsuba's shadow rays begin and end, if so asked."""
        to_light = np.array(light["position"]) - point if light["kind"] == "point" else -np.array(light["direction"])
        if as_theirs:
            # Its RayEpsilon and ShadowEpsilon.
            normal = self.normals[triangle]
            point = point + normal * np.sign(np.sum(normal * to_light)) * 1500 * ROUNDOFF * (1 + np.max(np.abs(point)))
        if light["kind"] == "point":
            to_light = np.array(light["position"]) - point
            reach = np.linalg.norm(to_light) * (1 - 15000 * ROUNDOFF if as_theirs else 1)
        else:
            reach = np.inf
        t = self.hits(point, to_light / np.linalg.norm(to_light))
        t[triangle] = np.inf
        return bool(np.min(t) < reach)


def judge(name, make, options, work):
    """Compares both renderers on one scene; whether they agree."""
    size, fine = options.size, True
    scene = make(work if make is knot else options.scenes)
    _, parts, camera, lights = scene
    exact = Exact(parts, camera, size)
    pixels = size * size
    directions = exact.rays(*np.meshgrid(np.arange(size), np.arange(size), indexing="ij"))
    say = lambda text: print(f"{name:8} {text}")
    sum_ours, sum_theirs, sum_allowed, any_shadow = 0.0, 0.0, 0.0, np.zeros((size, size), bool)
    for i, light in enumerate(lights):
        mine = ours(options.tessera, work, f"{name}-{i}", scene, [light], size)
        picture = np.stack([mine[c].pixels for c in "RGB"], -1).astype(np.float64)
        if i == 0:
            # Geometry, which is the same for all lights.
            other, points, triangles, albedo = theirs(work, scene, [light], size)
            hit, index = triangles >= 0, np.maximum(triangles, 0)
            ids = mine["id.triangle"].pixels.astype(np.int64)
            known = as_theirs(np.where(ids == MISS, -1, ids), triangles)
            same = known == triangles
            others = np.count_nonzero(~same)
            seen = same & hit
            steep = np.abs(np.sum(exact.normals[index] * directions, -1))
            true = np.linalg.norm(exact.points(directions, index) - np.array(camera["eye"]), axis=-1)
            across = lambda t: np.max((np.abs(t - true) / true * steep)[seen])
            own = across(mine["depth.Z"].pixels.astype(np.float64))
            foreign = across(np.linalg.norm(points - np.array(camera["eye"]), axis=-1))
            say(f"{size} x {size} pixels, {len(exact.corners)} triangles, {np.count_nonzero(hit)} pixels hit one")
            say(f"another triangle in {others} pixels (bound {TRIANGLE_BOUND * pixels:.0f}){exact.verdict(directions, known, triangles)}")
            say(f"hits across the triangle, of the distance: ours {own:.1e} from the truth, theirs {foreign:.1e} (bound {HIT_BOUND:.1e})")
            fine &= others <= TRIANGLE_BOUND * pixels and max(own, foreign) <= HIT_BOUND
        else:
            other = theirs(work, scene, [light], size)[0]

        # What the light would send back straight on, and how far rounding may lead from it.
        strength = light["intensity"] * np.array(light["color"])
        allowed = 16 * ROUNDOFF + 4 * ROUNDOFF * exact.extent / exact.heights[index]
        if light["kind"] == "point":
            way = np.maximum(np.linalg.norm(points - np.array(light["position"]), axis=-1), 1e-30)
            strength = strength / way[..., None] ** 2
            allowed = allowed + 6 * HIT_BOUND * true / (steep * way)
        straight = np.max(albedo * strength / np.pi, axis=-1)
        allowed = allowed * straight

        # Lit by one and dark in the other beyond rounding: a shadow. The truth says whose.
        error = np.max(np.abs(picture - other), axis=-1)
        dark = [np.max(p, axis=-1) == 0 for p in (picture, other)]
        shadow = seen & (dark[0] != dark[1]) & (error > allowed)
        right, begun_late = 0, 0
        for row, column in np.argwhere(shadow):
            triangle = index[row, column]
            point = exact.points(directions[row, column], triangle)
            right += exact.is_blocked(point, triangle, light) == dark[0][row, column]
            begun_late += exact.is_blocked(point, triangle, light, as_theirs=True) == dark[1][row, column]
        compared = seen & ~shadow & (straight > 0)
        relative, explained = error[compared] / straight[compared], np.max(error[compared] / allowed[compared])
        lit = ~dark[0] & ~dark[1] & compared
        say(
            f"light {i}, {light['kind']}: {np.count_nonzero(lit)} pixels lit, sum of ours / theirs"
            f" {np.sum(picture[lit]) / np.sum(other[lit]):.8f}; difference, of the light straight on:"
            f" rms {np.sqrt(np.mean(relative**2)):.1e}, greatest {np.max(relative):.1e};"
            f" at most {explained:.2f} of what rounding explains"
        )
        disputed = np.count_nonzero(shadow)
        if disputed:
            say(
                f"         another shadow in {disputed} pixels (bound {SHADOW_BOUND * pixels:.0f}), dark in ours alone"
                f" {np.count_nonzero(shadow & dark[0])}; the truth is with ours in {right}, with theirs in {disputed - right};"
                f" in {begun_late} it is theirs for rays that begin and end where Mitsuba's do"
            )
        fine &= bool(explained <= 1) and disputed <= SHADOW_BOUND * pixels and disputed - min(right, begun_late) <= WRONG_BOUND * pixels
        sum_ours, sum_theirs, sum_allowed = sum_ours + picture, sum_theirs + other, sum_allowed + allowed
        any_shadow |= shadow

    # All lights at once add up.
    mine = ours(options.tessera, work, f"{name}-all", scene, lights, size)
    picture = np.stack([mine[c].pixels for c in "RGB"], -1).astype(np.float64)
    compared = seen & ~any_shadow & (sum_allowed > 0)
    together = np.max(np.max(np.abs(picture - sum_theirs), axis=-1)[compared] / sum_allowed[compared])
    say(f"all lights together: at most {together:.2f} of what rounding explains")
    fine &= bool(together <= 1)

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
