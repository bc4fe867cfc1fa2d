//! Paths written down ray by ray.

use crate::support::{stages::bazaar, *};
use tessera_geometry::Hit;
use tessera_whitted::{PixelFormat, Probe, RayCounts, Renderer};

#[test]
fn what_is_written_down_is_what_is_rendered() {
    let pack = bazaar().pack();
    let renderer = Renderer::new(&pack);
    for samples in [1, 4] {
        let view = View { samples, ..look([0.3, 0.6, 5.0], [0.0; 3]).sized(48, 40) };
        let params = view.params(&pack, PixelFormat::Layers);
        let (pixels, counts) = view.layers(&pack);
        let (mut looks, mut shadows, mut layers) = (0, 0, 0);
        for (i, pixel) in pixels.iter().enumerate() {
            for sample in 0..samples {
                let (x, y) = (i as u32 % view.width, i as u32 / view.width);
                let rays = renderer.probe(&params, x, y, sample);
                let of_kind = |kind| rays.iter().filter(|ray| ray.kind == kind).count() as u64;
                looks += of_kind(Probe::LOOK);
                shadows += of_kind(Probe::OPAQUE);
                layers += of_kind(Probe::LAYER);
                assert_eq!(rays[0].kind, Probe::LOOK);
                // The surface behind a pixel's centre is that of the only sample, and no veil here is quite clear.
                if samples == 1 {
                    let id = if rays[0].is_hit() { pack.original_id(rays[0].triangle) } else { u32::MAX };
                    assert_eq!(id, pixel.id, "pixel {i}");
                    assert!(
                        !rays[0].is_hit() || pixel.depth == (f64::from(rays[0].t) * pack.frame().step) as f32
                    );
                }
                assert!(rays.iter().all(|ray| renderer.answer(ray) == *ray), "pixel {i}");
                // It follows its own rays to the end, and no bit away.
                let replay = renderer.replay(&params, x, y, sample, &rays);
                assert!(replay.is_whole && replay.steps.len() == rays.len());
                for step in replay.steps {
                    assert_eq!(step.bound.share(&step.own, &step.other), 0.0, "pixel {i}: {step:?}");
                }
            }
        }
        let RayCounts { primary, shadow, reflection, refraction } = counts;
        // With many samples the surface behind each pixel's centre is looked for besides.
        let eyes = if samples == 1 { primary } else { primary - pixels.len() as u64 };
        assert_eq!((looks, shadows), (eyes + reflection + refraction, shadow));
        assert!(layers > 1000 && reflection > 500 && refraction > 500, "{layers} layers, {counts:?}");
    }
}

#[test]
fn a_signature_is_of_kinds_and_triangles_in_their_order() {
    let ray = |kind, triangle| Probe { kind, triangle, ..bytemuck::Zeroable::zeroed() };
    // FNV-1a by hand.
    let step = |hash: u64, word: u64| ((hash ^ word) * 0x0100_0193) & 0xFFFF_FFFF;
    let expected = step(step(step(step(0x811c_9dc5, 0), 7), 1), 0xFFFF_FFFF) as u32;
    let rays = [ray(Probe::LOOK, 7), ray(Probe::OPAQUE, Hit::NO_TRIANGLE)];
    assert_eq!(Probe::signature(&rays), expected);
    assert_eq!(Probe::signature(&[]), 0x811c_9dc5);
    let turned = [rays[1], rays[0]];
    let other_place = [Probe { t: 3.0, origin: [1.0; 3], ..rays[0] }, rays[1]];
    assert_ne!(Probe::signature(&turned), expected);
    assert_eq!(Probe::signature(&other_place), expected);
}

/// A path that could not be this renderer's ends where it leaves it.
#[test]
fn a_replay_stops_where_another_kind_of_ray_should_stand() {
    let pack = bazaar().pack();
    let renderer = Renderer::new(&pack);
    let params = look([0.3, 0.6, 5.0], [0.0; 3]).sized(48, 40).params(&pack, PixelFormat::Layers);
    let rays = renderer.probe(&params, 14, 20, 0);
    assert!(rays.len() > 10);
    let shadow = rays.iter().position(|ray| ray.kind == Probe::OPAQUE).expect("it is lit");
    let without = [&rays[..shadow], &rays[shadow + 1..]].concat();
    let replay = renderer.replay(&params, 14, 20, 0, &without);
    assert!(!replay.is_whole && replay.steps.len() <= shadow + 1);
    let replay = renderer.replay(&params, 14, 20, 0, &rays[..4]);
    assert!(!replay.is_whole && replay.steps.len() == 4);
    let more = [&rays[..], &rays[..1]].concat();
    assert!(!renderer.replay(&params, 14, 20, 0, &more).is_whole);
    // An id that the scene does not have.
    let mut wild = rays.clone();
    wild[0].triangle = pack.triangle_count();
    assert!(!renderer.replay(&params, 14, 20, 0, &wild).is_whole);
}
