// Sibling of color.rs, for codes of 8 bits. Neither function does arithmetic on floats: their codes are those of the CPU
// for every bit pattern, on any device.
//
// Numbers are compared as integers: bit patterns of floats >= 0 rise with their values up to +infinity, and those of
// negative ones are negative.

/// The sRGB code nearest to `linear`, which is clamped to [0, 1] first; NaN becomes 0. `srgb_threshold(i)` is the least
/// number whose code is at least `i`, for `i` in 1..=255.
fn encode_srgb(linear: f32) -> u32 {
    if is_nan(linear) {
        return 0u;
    }

    // Search for the greatest code whose threshold is not above.
    let bits = bitcast<i32>(linear);
    var code = 0u;
    for (var step = 128u; step > 0u; step >>= 1u) {
        if bits >= bitcast<i32>(srgb_threshold(code + step)) {
            code += step;
        }
    }
    return code;
}

/// The same without the curve, for alpha: `floor(255 value + 1/2)`.
fn encode_linear(value: f32) -> u32 {
    if is_nan(value) {
        return 0u;
    }

    // Clamp; below 2^-9 is 255 value < 1/2.
    let bits = bitcast<i32>(value);
    if bits < 0x3b000000 {
        return 0u;
    }
    if bits >= 0x3f800000 {
        return 255u;
    }

    // value = mantissa / 2^shift with mantissa < 2^24 and shift in 24..=32, so 255 mantissa fits in a word. Half the
    // floor of twice a number + 1, rounded down, is the floor of the number + 1/2.
    let mantissa = (u32(bits) & 0x007fffffu) | 0x00800000u;
    let shift = 150u - (u32(bits) >> 23u);
    return (((255u * mantissa) >> (shift - 1u)) + 1u) >> 1u;
}

fn is_nan(v: f32) -> bool {
    return (bitcast<u32>(v) & 0x7fffffffu) > 0x7f800000u;
}
