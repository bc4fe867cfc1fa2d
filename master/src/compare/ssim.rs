//! Structural similarity.

use super::Picture;

/// Side of an SSIM window.
const WINDOW: usize = 11;

/// Mean SSIM (Wang, Bovik, Sheikh, Simoncelli 2004) as in the authors' `ssim.m`: Gaussian weights of sigma 1.5 with sum 1, K1 = 0.01,
/// K2 = 0.03, only windows that lie wholly inside the image.
pub(super) fn ssim(a: &Picture, b: &Picture, peak: f64) -> Option<f64> {
    let (width, height) = (a.width as usize, a.height as usize);
    if width < WINDOW || height < WINDOW {
        return None;
    }
    let weights = gaussian();
    let c1 = (0.01 * peak) * (0.01 * peak);
    let c2 = (0.03 * peak) * (0.03 * peak);
    let mut sum = 0.0;
    for (ca, cb) in a.channels.iter().zip(&b.channels) {
        // Weighted window means of a, b, a^2, b^2 and ab: first along the rows, then down the columns as the rows come.
        let columns = width - WINDOW + 1;
        let mut rows: Vec<Vec<[f64; 5]>> = Vec::with_capacity(WINDOW);
        for y in 0..height {
            let row = y * width..(y + 1) * width;
            let means = blur_row(&ca[row.clone()], &cb[row], &weights);
            if rows.len() == WINDOW {
                rows.remove(0);
            }
            rows.push(means);
            if rows.len() < WINDOW {
                continue;
            }
            for x in 0..columns {
                let mut m = [0.0; 5];
                for (weight, row) in weights.iter().zip(&rows) {
                    for (total, value) in m.iter_mut().zip(row[x]) {
                        *total += weight * value;
                    }
                }
                let [ma, mb, maa, mbb, mab] = m;
                let (va, vb, cov) = (maa - ma * ma, mbb - mb * mb, mab - ma * mb);
                sum += (2.0 * ma * mb + c1) * (2.0 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
            }
        }
    }
    Some(sum / (3 * (width - WINDOW + 1) * (height - WINDOW + 1)) as f64)
}

fn blur_row(a: &[f32], b: &[f32], weights: &[f64; WINDOW]) -> Vec<[f64; 5]> {
    a.windows(WINDOW)
        .zip(b.windows(WINDOW))
        .map(|(a, b)| {
            let mut m = [0.0; 5];
            for ((&a, &b), weight) in a.iter().zip(b).zip(weights) {
                let (a, b) = (f64::from(a), f64::from(b));
                for (total, value) in m.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                    *total += weight * value;
                }
            }
            m
        })
        .collect()
}

fn gaussian() -> [f64; WINDOW] {
    let raw: [f64; WINDOW] = std::array::from_fn(|i| {
        let x = i as f64 - (WINDOW / 2) as f64;
        libm::exp(-x * x / (2.0 * 1.5 * 1.5))
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}
