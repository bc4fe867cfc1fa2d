//! How samples are taken: adaptively, by either sampler, down to any weight.

use crate::frames::{mixed_scene, mixed_view};
use crate::support::*;
use tessera_geometry::srgb_from_linear;
use tessera_kdtree::Kernel;
use tessera_pack::Plain;
use tessera_whitted::{
    Adaptive, FrameParams, PixelBlock, PixelFormat, RayCounts, Renderer, Sampler, Sampling,
};

fn adaptive(sampler: Sampler, error: f32) -> Sampling {
    Sampling { sampler, adaptive: Some(Adaptive { error }), ..Sampling::default() }
}

/// Pixels of `block`, and rays.
fn part(renderer: &Renderer<'_>, params: &FrameParams, block: PixelBlock) -> (Vec<u8>, RayCounts) {
    let mut out = vec![0; block.byte_len(params.format)];
    let counts = renderer.render_block(params, block, &mut out);
    (out, counts)
}

#[test]
fn a_pixel_depends_neither_on_its_tile_nor_on_the_kernel() {
    let pack = mixed_scene().pack_with(Plain::default()).expect("a packable scene");
    let (width, height) = (37, 45);
    for (sampler, format) in [
        (Sampler::Jittered, PixelFormat::Rgba8),
        (Sampler::LowDiscrepancy, PixelFormat::Rgba16),
        (Sampler::LowDiscrepancy, PixelFormat::Layers),
    ] {
        let view =
            View { samples: 40, sampling: adaptive(sampler, 0.03), ..mixed_view().sized(width, height) };
        let params = view.params(&pack, format);
        let (whole, counts) = view.bytes(&pack, format);
        let eyes = counts.primary - if format == PixelFormat::Layers { u64::from(width * height) } else { 0 };
        let most = u64::from(40 * width * height);
        assert!(
            eyes < most && eyes > most / 4,
            "{eyes} of {most}: some blocks are finished early, others not"
        );
        // Multiples of 16 share no block; others do, and the picture is the same.
        for (kernel, sides) in [(Kernel::Scalar, &[16][..]), (Kernel::default(), &[16, 48, 11])] {
            let renderer = Renderer::with_kernel(&pack, kernel);
            for &side in sides {
                let mut sum = RayCounts::default();
                for (x, y) in (0..height)
                    .step_by(side as usize)
                    .flat_map(|y| (0..width).step_by(side as usize).map(move |x| (x, y)))
                {
                    let block = PixelBlock { x, y, width: side.min(width - x), height: side.min(height - y) };
                    let (bytes, rays) = part(&renderer, &params, block);
                    sum += rays;
                    let row_bytes = block.width as usize * format.bytes_per_pixel();
                    for (row, bytes) in (y..).zip(bytes.chunks_exact(row_bytes)) {
                        let at = (row * width + x) as usize * format.bytes_per_pixel();
                        assert_eq!(bytes, &whole[at..][..row_bytes], "{format:?}, row {row} of {block:?}");
                    }
                }
                assert!(side % 16 != 0 || sum == counts, "{sum:?} instead of {counts:?}");
            }
        }
    }
}

#[test]
fn few_samples_leave_nothing_to_decide() {
    let pack = mixed_scene().pack();
    // 16 x 16 pixels: no block is cut by the image's edge.
    let view = mixed_view().sized(16, 16);
    for samples in [1, 2, 16] {
        let uniform = View { samples, ..view };
        let open = View { sampling: adaptive(Sampler::Jittered, 1.0), ..uniform };
        for format in [PixelFormat::Rgba8, PixelFormat::Layers] {
            assert_eq!(open.bytes(&pack, format), uniform.bytes(&pack, format), "{samples} samples");
        }
    }
}

/// The coded root mean square error of each block against a picture of many samples, and the samples that were taken.
fn errors(pack: &tessera_pack::Pack, view: &View, truth: &[Layers]) -> (Vec<f64>, f64) {
    let code = |linear: f32| srgb_from_linear(f64::from(linear.clamp(0.0, 1.0)));
    let (seen, counts) = view.layers(pack);
    let (columns, rows) = (view.width / 16, view.height / 16);
    let mut blocks = vec![0.0; (columns * rows) as usize];
    for ((a, b), place) in seen.iter().zip(truth).zip(0u32..) {
        let (x, y) = (place % view.width, place / view.width);
        let worst = (0..3).map(|i| (code(a.color[i]) - code(b.color[i])).abs()).fold(0.0, f64::max);
        let worst = worst.max(f64::from((a.alpha - b.alpha).abs()));
        blocks[(y / 16 * columns + x / 16) as usize] += worst * worst / 256.0;
    }
    let taken = (counts.primary as f64) / f64::from(view.width * view.height) - 1.0;
    (blocks.into_iter().map(f64::sqrt).collect(), taken)
}

#[test]
fn blocks_are_as_good_as_was_asked_for() {
    let pack = mixed_scene().pack();
    let view = mixed_view().sized(64, 48);
    let reference = View {
        samples: 1024,
        sampling: Sampling { sampler: Sampler::LowDiscrepancy, ..Sampling::default() },
        ..view
    };
    let truth = reference.layers(&pack).0;
    for (sampler, threshold) in
        [(Sampler::LowDiscrepancy, 0.02), (Sampler::LowDiscrepancy, 0.01), (Sampler::Jittered, 0.02)]
    {
        let sampled = View { samples: 256, sampling: adaptive(sampler, threshold), ..view };
        let (errors, taken) = errors(&pack, &sampled, &truth);
        let worst = errors.iter().copied().fold(0.0, f64::max);
        println!("{sampler:?} to {threshold}: {taken:.1} samples a pixel, worst block {worst:.4}");
        assert!(taken < 128.0, "{taken} samples a pixel: most blocks are easy");
        // The estimate's expectation is at least the squared error. A block at the threshold whose estimate comes from few pixels is
        // off by a standard deviation of the root of 2 / 16, so its error by half of that; three of them.
        let most = f64::from(threshold) * (1.0 + 1.5 * libm::sqrt(2.0 / 16.0));
        assert!(worst <= most, "{worst} for {threshold}");
    }
}

#[test]
fn any_weight_ends_and_less_of_it_traces_more() {
    let pack = mixed_scene().pack();
    let rays = |cutoff: f32, samples: u32| {
        let sampling = Sampling { cutoff, ..Sampling::default() };
        let (pixels, counts) = View { sampling, samples, ..mixed_view() }.layers(&pack);
        (pixels, counts.reflection + counts.refraction)
    };
    let (usual, counted) = rays(Sampling::CUTOFF, 1);
    assert_eq!(rays(1.0 / 512.0, 1).0, usual);
    let mut before = u64::MAX;
    for cutoff in [0.0, 1.0 / 65_536.0, Sampling::CUTOFF, 0.1, 1.0] {
        let (pixels, rays) = rays(cutoff, 1);
        assert!(rays <= before, "{rays} rays down to {cutoff}, {before} down to less");
        before = rays;
        if cutoff == 0.0 {
            assert!(rays > counted, "something was cut off");
            for (a, b) in pixels.iter().zip(&usual) {
                assert_eq!((a.depth, a.id), (b.depth, b.id));
            }
        }
    }
}

/// Without lights, in surroundings of radiance 1 and ambient light of 1, nothing shows more than 1: what a surface weighs its ambient light and
/// its rays by sums to at most 1. A ray that is not traced has less than the cut-off `w` in each channel and takes away at most that; each such ray,
/// and whatever lies behind it, is one more of those that are traced without a cut-off. So no channel of a pixel loses more than `w` times the
/// rays that it lacks.
#[test]
fn what_is_cut_off_takes_no_more_than_its_weight() {
    let mut stage = mixed_scene();
    stage.input.lights.clear();
    stage.surround();
    let pack = stage.pack();
    let renderer = Renderer::new(&pack);
    let pixels = |cutoff: f32| {
        let view = View { sampling: Sampling { cutoff, ..Sampling::default() }, ..mixed_view() };
        let params = view.params(&pack, PixelFormat::Layers);
        let at = (0..view.height).flat_map(|y| (0..view.width).map(move |x| (x, y)));
        at.map(|(x, y)| {
            let (bytes, counts) = part(&renderer, &params, PixelBlock { x, y, width: 1, height: 1 });
            (decode(&bytes)[0].color, counts.reflection + counts.refraction)
        })
        .collect::<Vec<_>>()
    };
    // Some hundred products and sums that come to at most 1 are off by 2^-24 each.
    let rounding = 256.0 / (1 << 24) as f32;
    let all = pixels(0.0);
    assert!(all.iter().flat_map(|(color, _)| color).all(|&c| (0.0..=1.0 + rounding).contains(&c)));
    for cutoff in [1.0 / 65_536.0, Sampling::CUTOFF, 0.1, 1.0] {
        let (mut lacking, mut darker) = (0, 0);
        for (k, ((open, open_rays), (color, rays))) in all.iter().zip(pixels(cutoff)).enumerate() {
            let lacks = open_rays - rays;
            lacking += u32::from(lacks > 0);
            for (open, c) in open.iter().zip(color) {
                let lost = open - c;
                assert!(
                    (-rounding..=lacks as f32 * cutoff + rounding).contains(&lost),
                    "pixel {k} loses {lost} with {lacks} rays less, of less than {cutoff}"
                );
                darker += u32::from(lost > rounding);
            }
        }
        assert!(
            lacking > 0 && (darker > 0 || cutoff < Sampling::CUTOFF),
            "{lacking} pixels lack rays, {darker} channels light: {cutoff}"
        );
    }
}
