//! The tree of a prepared pack finds what a test of every triangle finds: real and generated scenes, 10^4 rays each.

use crate::support::scene_folder;
use std::path::Path;
use std::time::Duration;
use tessera_geometry::{Ray, Vec3};
use tessera_kdtree::brute_force_closest;
use tessera_master::prepare::{PrepareOptions, Prepared, prepare, prepare_scene};
use tessera_scene::generate::{Kind, Recipe, generate};

const RAYS: usize = 10_000;

/// A reproducible sequence (Knuth's MMIX constants), the upper bits of it.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1 << 24) as f32
    }

    fn point(&mut self, low: Vec3, high: Vec3) -> Vec3 {
        low + (high - low) * Vec3::new(self.unit(), self.unit(), self.unit())
    }
}

/// Rays of every kind: between points of the box, from outside, along axes, aimed at vertices and at middles of edges.
fn ray(i: usize, random: &mut Random, prepared: &Prepared) -> Ray {
    let pack = &prepared.pack;
    let bounds = pack.tree().bounds;
    let (low, high) = (bounds.min, bounds.max);
    let from = random.point(low, high);
    let id = (random.unit() * pack.triangle_count() as f32) as u32;
    let corners = tessera_kdtree::Triangles::vertices(&pack.mesh(), id.min(pack.triangle_count() - 1));
    let (origin, to) = match i % 5 {
        0 => (from, random.point(low, high)),
        1 => (low - (high - low) * random.unit(), from),
        2 => (from, from + [Vec3::X, Vec3::NEG_Y, Vec3::Z][i / 5 % 3]),
        3 => (from, corners[i / 5 % 3]),
        _ => (from, (corners[0] + corners[1]) * 0.5),
    };
    Ray { origin, direction: to - origin, t_min: 0.0, t_max: f32::INFINITY }
}

fn check(prepared: &Prepared) {
    let pack = &prepared.pack;
    let (tree, mesh) = (pack.tree(), pack.mesh());
    let mut random = Random(7);
    let mut hits = 0;
    for i in 0..RAYS {
        let ray = ray(i, &mut random, prepared);
        let found = tree.closest_hit(&mesh, &ray, |_| true);
        let expected = brute_force_closest(pack.triangle_count(), &mesh, &ray, |_| true);
        let bits = |hit: Option<tessera_geometry::Hit>| hit.map(|h| (h.triangle, h.t.to_bits()));
        assert_eq!(bits(found), bits(expected), "{}, ray {i}: {ray:?}", prepared.name);
        hits += usize::from(found.is_some());
    }
    assert!(hits > RAYS / 4, "{}: only {hits} of {RAYS} rays hit anything", prepared.name);
}

fn check_generated(kind: Kind) {
    let scene = generate(&Recipe { kind, triangles: 20_000, seed: 1 }).expect("in range");
    check(&prepare_scene(scene, &PrepareOptions::default(), Duration::ZERO).expect("it packs"));
}

fn check_file(folder: &Path, name: &str) {
    check(&prepare(&folder.join(name), &PrepareOptions::default()).expect("it packs"));
}

#[test]
fn cornell() {
    check_generated(Kind::Cornell);
}

#[test]
fn hall() {
    check_generated(Kind::Hall);
}

#[test]
fn rooms() {
    check_generated(Kind::Rooms);
}

#[test]
fn plant() {
    check_generated(Kind::Plant);
}

#[test]
fn city() {
    check_generated(Kind::City);
}

#[test]
fn every_generator_is_tested() {
    assert_eq!(Kind::ALL.len(), 5, "give the new generator a test above");
}

#[test]
fn bunny() {
    if let Some(folder) = scene_folder() {
        check_file(&folder, "stanford_bunny/bun_zipper.ply");
    }
}

#[test]
fn dragon() {
    if let Some(folder) = scene_folder() {
        check_file(&folder, "stanford_dragon/dragon_vrip_res4.ply");
    }
}
