//! The ray sets: cameras around or inside a mesh, and secondary rays from what they see.
//!
//! They are the rays of a yardstick that other programs implement too; order of rays, random numbers and every formula are part of
//! the definition.
//!
//! | rays | query | origin and direction | `t_max` |
//! |---|---|---|---|
//! | primary | closest hit | pixel centres | infinity |
//! | shadow | any hit | from a primary hit to the view's light | 0.9999 of the distance |
//! | diffuse | closest hit | from a primary hit, cosine-weighted about the normal | infinity |
//!
//! Directions have unit length and `t_min` is 0. Angles go through `libm`, so that the rays are the same on every machine; a platform's
//! own sine or tangent may give the last bit of a direction another value.

use super::mesh::Mesh;
use super::peer::Peer;
use std::f32::consts::PI;
use std::str::FromStr;
use tessera_geometry::{Aabb, Vec3};

/// A ray in world space, as every peer gets it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldRay {
    pub origin: Vec3,
    pub t_min: f32,
    pub direction: Vec3,
    pub t_max: f32,
}

const _: () = assert!(size_of::<WorldRay>() == 32);

/// What every peer answers to a closest-hit query.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldHit {
    /// Distance in world units, infinity for a miss.
    pub t: f32,
    /// Triangle of the mesh, [`WorldHit::MISS`]'s for a miss.
    pub triangle: u32,
}

const _: () = assert!(size_of::<WorldHit>() == 8);

impl WorldHit {
    /// Nothing was hit.
    pub const MISS: Self = Self { t: f32::INFINITY, triangle: u32::MAX };

    pub fn is_hit(&self) -> bool {
        self.t.is_finite()
    }
}

/// Which rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum RayKind {
    /// From the camera through pixel centres, the closest hit.
    Primary,
    /// From what the camera sees to a point light, any hit.
    Shadow,
    /// From what the camera sees in random directions, the closest hit.
    Diffuse,
}

impl RayKind {
    pub const ALL: [Self; 3] = [Self::Primary, Self::Shadow, Self::Diffuse];

    pub fn name(self) -> &'static str {
        match self {
            Self::Primary => "primary",
            Self::Shadow => "shadow",
            Self::Diffuse => "diffuse",
        }
    }
}

/// Which cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Views {
    /// Three around the mesh, for objects.
    Orbit,
    /// Three in its middle, for rooms.
    Inside,
    /// One: eye, target and vertical field of view in degrees.
    Given([f32; 7]),
}

impl FromStr for Views {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "orbit" => return Ok(Self::Orbit),
            "inside" => return Ok(Self::Inside),
            _ => {}
        }
        let numbers: Option<Vec<f32>> =
            text.split(',').map(|n| n.trim().parse().ok().filter(|n: &f32| n.is_finite())).collect();
        let numbers = numbers.and_then(|numbers| <[f32; 7]>::try_from(numbers).ok());
        let is_camera = |n: &[f32; 7]| {
            // A camera that looks along +Y or -Y has no right-hand side.
            let forward = Vec3::new(n[3] - n[0], n[4] - n[1], n[5] - n[2]);
            n[6] > 0.0 && n[6] < 180.0 && forward.cross(Vec3::Y).length_squared() > 0.0
        };
        numbers.filter(is_camera).map(Self::Given).ok_or_else(|| {
            "write orbit, inside, or ex,ey,ez,tx,ty,tz,fov: eye and target, not straight above each other, and the vertical field \
             of view in degrees"
                .into()
        })
    }
}

/// A camera with +Y up, and the point light of its shadow rays.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    pub name: String,
    pub eye: Vec3,
    pub target: Vec3,
    /// Vertical, degrees.
    pub fov: f32,
    pub light: Vec3,
}

impl Views {
    /// The cameras for a mesh that fills `bounds`.
    pub fn of(&self, bounds: &Aabb) -> Vec<View> {
        let Aabb { min, max } = *bounds;
        let centre = (min + max) * 0.5;
        let diagonal = (max - min).length();
        // A third of a turn.
        let azimuth = |first: f32, i: u8| first + f32::from(i) * 2.094_395_2;
        match *self {
            Self::Orbit => (0..3u8)
                .map(|i| {
                    let (azimuth, elevation) = (azimuth(0.5, i), 0.35);
                    let distance = 0.9 * diagonal;
                    let eye = Vec3::new(
                        centre.x + distance * libm::sinf(azimuth) * libm::cosf(elevation),
                        centre.y + distance * libm::sinf(elevation),
                        centre.z + distance * libm::cosf(azimuth) * libm::cosf(elevation),
                    );
                    let light = centre + Vec3::new(0.6, 1.1, 0.4) * diagonal;
                    View { name: format!("orbit{i}"), eye, target: centre, fov: 45.0, light }
                })
                .collect(),
            Self::Inside => (0..3u8)
                .map(|i| {
                    let azimuth = azimuth(0.3, i);
                    let eye = Vec3::new(centre.x, min.y + 0.4 * (max.y - min.y), centre.z);
                    let ahead = Vec3::new(
                        diagonal * libm::sinf(azimuth),
                        0.05 * diagonal,
                        diagonal * libm::cosf(azimuth),
                    );
                    let light = Vec3::new(
                        centre.x + 0.02 * diagonal,
                        min.y + 0.85 * (max.y - min.y),
                        centre.z + 0.01 * diagonal,
                    );
                    View { name: format!("inside{i}"), eye, target: eye + ahead, fov: 60.0, light }
                })
                .collect(),
            Self::Given([ex, ey, ez, tx, ty, tz, fov]) => vec![View {
                name: "given".into(),
                eye: Vec3::new(ex, ey, ez),
                target: Vec3::new(tx, ty, tz),
                fov,
                light: Vec3::new(ex, ey + 0.05 * diagonal, ez),
            }],
        }
    }
}

/// All kinds of rays of a view; `reference` finds where the secondary ones start.
pub fn ray_sets(view: &View, mesh: &Mesh, reference: &dyn Peer, side: u32) -> [(RayKind, Vec<WorldRay>); 3] {
    let rays = primary(view, side);
    let mut hits = vec![WorldHit::MISS; rays.len()];
    reference.closest(&rays, &mut hits);
    let [shadow, diffuse] = secondary(view, mesh, &rays, &hits);
    [(RayKind::Primary, rays), (RayKind::Shadow, shadow), (RayKind::Diffuse, diffuse)]
}

/// Pixels along a side of a tile of [`primary`].
pub const TILE: u32 = 16;

/// `side * side` rays; `side` is a multiple of [`TILE`]. Order: tiles row by row; in a tile, blocks of 4 x 2 pixels row by row; in a
/// block, row by row. So eight consecutive rays are one packet.
pub fn primary(view: &View, side: u32) -> Vec<WorldRay> {
    assert!(side.is_multiple_of(TILE), "whole tiles only");
    let forward = unit(view.target - view.eye);
    let right = unit(forward.cross(Vec3::Y));
    let up = right.cross(forward);
    let half = libm::tanf(view.fov.to_radians() * 0.5);
    let ray = |column: u32, row: u32| {
        let at = |pixel: u32| 2.0 * (pixel as f32 + 0.5) / side as f32;
        let x = (at(column) - 1.0) * half;
        let y = (1.0 - at(row)) * half;
        WorldRay {
            origin: view.eye,
            t_min: 0.0,
            direction: unit(forward + right * x + up * y),
            t_max: f32::INFINITY,
        }
    };
    let mut rays = Vec::with_capacity((side * side) as usize);
    let steps = |step: usize| (0..TILE).step_by(step);
    for tile_y in (0..side).step_by(TILE as usize) {
        for tile_x in (0..side).step_by(TILE as usize) {
            for (block_y, block_x) in steps(2).flat_map(|y| steps(4).map(move |x| (y, x))) {
                for (y, x) in (0..2).flat_map(|y| (0..4).map(move |x| (y, x))) {
                    rays.push(ray(tile_x + block_x + x, tile_y + block_y + y));
                }
            }
        }
    }
    rays
}

/// Shadow rays and diffuse rays from the primary hits, in their order, misses left out.
pub fn secondary(view: &View, mesh: &Mesh, rays: &[WorldRay], hits: &[WorldHit]) -> [Vec<WorldRay>; 2] {
    // Start this far from the surface, on the viewer's side: no ray meets the triangle that it starts from, in any peer.
    let Aabb { min, max } = mesh.bounds();
    let offset = 1e-4 * (max - min).length();
    let hit_rays = (0u32..).zip(rays.iter().zip(hits)).filter(|(_, (_, hit))| hit.is_hit());
    hit_rays
        .map(|(i, (ray, hit))| {
            let [a, b, c] = mesh.corners(hit.triangle);
            let mut normal = unit((b - a).cross(c - a));
            if normal.dot(ray.direction) > 0.0 {
                normal = -normal;
            }
            let origin = ray.origin + ray.direction * hit.t + normal * offset;
            let to_light = view.light - origin;
            let distance = to_light.length();
            let shadow =
                WorldRay { origin, t_min: 0.0, direction: to_light / distance, t_max: distance * 0.9999 };
            let random = [u01(i.wrapping_mul(2)), u01(i.wrapping_mul(2).wrapping_add(1))];
            let direction = cosine_weighted(normal, random);
            (shadow, WorldRay { origin, t_min: 0.0, direction, t_max: f32::INFINITY })
        })
        .unzip()
        .into()
}

/// A direction about `normal` with density proportional to its cosine (Malley's method), in the basis of Duff et al. 2017, *Building
/// an Orthonormal Basis, Revisited*.
fn cosine_weighted(normal: Vec3, [u, v]: [f32; 2]) -> Vec3 {
    let (radius, angle) = (u.sqrt(), 2.0 * PI * v);
    let (x, y, z) = (radius * libm::cosf(angle), radius * libm::sinf(angle), (1.0 - u).max(0.0).sqrt());
    let n = normal;
    let sign = 1f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let tangent = Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    let bitangent = Vec3::new(b, sign + n.y * n.y * a, -n.y);
    unit(tangent * x + bitangent * y + n * z)
}

/// Divided by its length, not multiplied by the inverse.
fn unit(v: Vec3) -> Vec3 {
    v / v.length()
}

/// The PCG output function (O'Neill 2014; Jarzynski and Olano 2020) of a counter, upper 24 bits, as a number in [0, 1).
fn u01(counter: u32) -> f32 {
    let state = counter.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    let word = (word >> 22) ^ word;
    (word >> 8) as f32 / 16_777_216.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh() -> Mesh {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
        Mesh::new("triangle".into(), positions, vec![[0, 1, 2]])
    }

    #[test]
    fn views_are_names_or_a_camera() {
        assert_eq!("orbit".parse(), Ok(Views::Orbit));
        assert_eq!("inside".parse(), Ok(Views::Inside));
        assert_eq!("1, 2,3,-4,5,6,60".parse(), Ok(Views::Given([1.0, 2.0, 3.0, -4.0, 5.0, 6.0, 60.0])));
        for bad in ["", "around", "1,2,3,4,5,6", "1,2,3,4,5,6,60,7", "1,2,3,4,5,6,0", "1,2,3,4,5,6,180"] {
            assert!(bad.parse::<Views>().is_err(), "{bad}");
        }
        for bad in ["0,0,0,0,1,0,60", "0,0,0,0,0,0,60", "nan,0,0,1,0,0,60", "0,inf,0,1,0,0,60"] {
            assert!(bad.parse::<Views>().is_err(), "{bad}");
        }
    }

    #[test]
    fn eight_rays_are_a_block_of_4_by_2_pixels() {
        let view = View {
            name: String::new(),
            eye: Vec3::new(0.0, 0.0, 5.0),
            target: Vec3::ZERO,
            fov: 90.0,
            light: Vec3::ZERO,
        };
        let rays = primary(&view, 32);
        assert_eq!(rays.len(), 32 * 32);
        // At 90 degrees and distance 1 the image spans -1 to 1: a pixel is a 16th.
        let pixel = |i: usize| {
            let d = rays[i].direction / -rays[i].direction.z;
            (((d.x + 1.0) * 16.0).floor() as u32, ((1.0 - d.y) * 16.0).floor() as u32)
        };
        let block: Vec<_> = (0..8).map(pixel).collect();
        assert_eq!(block, [(0, 0), (1, 0), (2, 0), (3, 0), (0, 1), (1, 1), (2, 1), (3, 1)]);
        // The next block of the tile, the next row of blocks, the next tile, the next row of tiles.
        assert_eq!([8, 32, 256, 512].map(pixel), [(4, 0), (0, 2), (16, 0), (0, 16)]);
        let mut all: Vec<_> = (0..rays.len()).map(pixel).collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), rays.len(), "every pixel once");
    }

    #[test]
    fn secondary_rays_start_on_the_viewers_side_of_what_was_hit() {
        let mesh = mesh();
        for side in [-1.0, 1.0] {
            let eye = Vec3::new(0.25, 0.25, 2.0 * side);
            let light = Vec3::new(0.0, 0.0, 3.0 * side);
            let view = View { name: String::new(), eye, target: Vec3::ZERO, fov: 45.0, light };
            let ray = WorldRay {
                origin: eye,
                t_min: 0.0,
                direction: Vec3::new(0.0, 0.0, -side),
                t_max: f32::INFINITY,
            };
            let hits = [WorldHit::MISS, WorldHit { t: 2.0, triangle: 0 }];
            let [shadow, diffuse] = secondary(&view, &mesh, &[ray; 2], &hits);
            let ([shadow], [diffuse]) = (&shadow[..], &diffuse[..]) else { panic!("one ray a hit") };
            assert_eq!(shadow.origin, diffuse.origin);
            let height = shadow.origin.z * side;
            assert!(height > 1e-4 && height < 2e-4, "{height}: 1e-4 of the box's diagonal");
            let arrival = shadow.origin + shadow.direction * (shadow.t_max / 0.9999);
            assert!(arrival.distance(light) < 1e-5, "{arrival}");
            assert!((diffuse.direction.length() - 1.0).abs() < 1e-6 && diffuse.direction.z * side > 0.0);
            assert_eq!(diffuse.t_max, f32::INFINITY);
        }
    }

    #[test]
    fn diffuse_directions_follow_the_cosine() {
        for normal in [Vec3::X, Vec3::NEG_Z, unit(Vec3::new(1.0, -2.0, 3.0))] {
            let cosines =
                (0..10_000).map(|i| cosine_weighted(normal, [u01(2 * i), u01(2 * i + 1)]).dot(normal));
            // The mean cosine under a density of cosine / pi is 2/3; its standard deviation here 0.236 / 100.
            let mean = cosines.sum::<f32>() / 10_000.0;
            assert!((mean - 2.0 / 3.0).abs() < 0.01, "{normal}: {mean}");
        }
    }

    #[test]
    fn random_numbers_are_those_of_the_definition() {
        // pcg(0) = 129708002, pcg(1) = 2831084092: upper 24 bits over 2^24.
        let expected = [129_708_002u32, 2_831_084_092].map(|word| (word >> 8) as f32 / 16_777_216.0);
        assert_eq!([u01(0), u01(1)], expected);
    }
}
