// Sibling of sample.rs; without 64-bit integers.

/// The hash that seeds all samples of the pixel `(x, y)` of the frame `frame_high` 2^32 + `frame_low`.
fn pixel_seed(frame_low: u32, frame_high: u32, x: u32, y: u32) -> u32 {
    let seed = pcg(frame_low ^ pcg(frame_high));
    return pcg(x ^ pcg(y ^ seed));
}

/// Sample `index` of `count` in the unit square of a pixel, `(0, 0)` at its upper left; both coordinates lie in [0,
/// 1].
fn offset_in_pixel(index: u32, count: u32, seed: u32) -> vec2<f32> {
    // Take the centre when there is only one.
    if count <= 1u {
        return vec2<f32>(0.5);
    }
    if frame.sampler == SAMPLER_LOW_DISCREPANCY {
        let at = low_discrepancy(index, seed);
        return vec2<f32>(unit_float(at.x), unit_float(at.y));
    }
    return jittered(index, count, seed);
}

fn jittered(index: u32, count: u32, seed: u32) -> vec2<f32> {
    // Lay a grid of columns x rows over the pixel, as square as the count allows.
    let columns = whole_root(count);
    let rows = (count - 1u) / columns + 1u;

    // Shuffle the order of the samples, and the substrata across columns and rows.
    let s = permute(index, count, seed * 0x51633e2du);
    let sx = permute(s % columns, columns, seed * 0x68bc21ebu);
    let sy = permute(s / columns, rows, seed * 0x02e5be93u);

    // Jitter inside the substratum.
    let jx = unit_float(pcg(s ^ (seed * 0x967a889bu)));
    let jy = unit_float(pcg(s ^ (seed * 0x368cc8b7u)));
    let across = f32(sx) + kept(quotient(kept(f32(sy) + jx), f32(rows)));
    let down = f32(s) + jy;
    return vec2<f32>(quotient(across, f32(columns)), quotient(down, f32(count)));
}

/// Sample `index` of the scrambled sequence, in units of 2^-32.
fn low_discrepancy(index: u32, seed: u32) -> vec2<u32> {
    let x = scramble(index, pcg(seed ^ 0x68bc21ebu));
    let y = scramble(second_dimension(index), pcg(seed ^ 0x02e5be93u));
    return vec2<u32>(reverseBits(x), reverseBits(y));
}

/// The bits of Sobol's second dimension, the highest last; those of the first are the index itself.
fn second_dimension(index: u32) -> u32 {
    var bits = index;
    bits ^= (bits >> 16u) & 0x0000ffffu;
    bits ^= (bits >> 8u) & 0x00ff00ffu;
    bits ^= (bits >> 4u) & 0x0f0f0f0fu;
    bits ^= (bits >> 2u) & 0x33333333u;
    return bits ^ ((bits >> 1u) & 0x55555555u);
}

/// Owen's scrambling of a number whose highest bit comes last: each bit is flipped, or not, by a hash of the bits before it.
fn scramble(number: u32, seed: u32) -> u32 {
    var bits = number;
    bits ^= bits * 0x3d20adeau;
    bits += seed;
    bits *= (seed >> 16u) | 1u;
    bits ^= bits * 0x05526c56u;
    return bits ^ (bits * 0x53a22864u);
}

/// The square root of `n` >= 1, rounded down: of the guess only that it is off by less than 1 is used. (k^2 <= n just
/// when k <= n / k, and k^2 may not fit.)
fn whole_root(n: u32) -> u32 {
    var k = max(u32(sqrt(f32(n))), 1u);
    if k > n / k {
        k -= 1u;
    }
    if k + 1u <= n / (k + 1u) {
        k += 1u;
    }
    return k;
}

/// PCG-RXS-M-XS-32, used as a hash (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering").
fn pcg(v: u32) -> u32 {
    let state = v * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

/// The top 24 bits as a number in [0, 1), exact in `f32`.
fn unit_float(hash: u32) -> f32 {
    return times(f32(hash >> 8u), 1.0 / 16777216.0);
}

/// Where `index` goes in the permutation of `0..length` that `pattern` names: an invertible hash on the next power of
/// two, walked until it falls below `length`, then rotated (Kensler 2013; the listing's sum can wrap around 2^32 and
/// then is no permutation).
fn permute(index: u32, length: u32, pattern: u32) -> u32 {
    var mask = 0u;
    if length > 1u {
        mask = 0xffffffffu >> countLeadingZeros(length - 1u);
    }
    var i = index;
    loop {
        i ^= pattern;
        i *= 0xe170893du;
        i ^= pattern >> 16u;
        i ^= (i & mask) >> 4u;
        i ^= pattern >> 8u;
        i *= 0x0929eb3fu;
        i ^= pattern >> 23u;
        i ^= (i & mask) >> 1u;
        i *= 1u | (pattern >> 27u);
        i *= 0x6935fa69u;
        i ^= (i & mask) >> 11u;
        i *= 0x74dcb303u;
        i ^= (i & mask) >> 2u;
        i *= 0x9e501cc3u;
        i ^= (i & mask) >> 2u;
        i *= 0xc860a3dfu;
        i &= mask;
        i ^= i >> 5u;
        if i < length {
            break;
        }
    }

    // Rotate: (i + pattern) mod length, where both summands are below length and their sum need not fit.
    let turn = pattern % length;
    return select(i + turn, i - (length - turn), i >= length - turn);
}
