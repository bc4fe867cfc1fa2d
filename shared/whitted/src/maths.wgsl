// The functions of the `libm` crate that the kernels call, for the arguments that they pass: WGSL's own have absolute errors
// that a highlight's exponent multiplies by up to 1024. No sibling here: `pow_unit`, `atan2f`, `atanf` and `acosf` are libm's
// `powf.rs`, `atan2f.rs`, `atanf.rs` and `acosf.rs`, step by step, and equal bit for bit where the device divides and takes
// roots correctly. `exp2_nonpositive` is `exp2f.rs`, whose `f64` becomes pairs of f32.
//
// A device may take numbers below 2^-126 for 0, and a compiler may assume that sums are associative: what an algorithm loses
// on purpose goes through `kept`.
//
// powf, atan2f, atanf, acosf:
// Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved.
// Developed at SunPro, a Sun Microsystems, Inc. business. Permission to use, copy, modify, and distribute this software is
// freely granted, provided that this notice is preserved.
//
// exp2f:
// Copyright (c) 2005 David Schultz <das@FreeBSD.ORG>. All rights reserved.
// Redistribution and use in source and binary forms, with or without modification, are permitted provided that the following
// conditions are met:
// 1. Redistributions of source code must retain the above copyright notice, this list of conditions and the following
//    disclaimer.
// 2. Redistributions in binary form must reproduce the above copyright notice, this list of conditions and the following
//    disclaimer in the documentation and/or other materials provided with the distribution.
// THIS SOFTWARE IS PROVIDED BY THE AUTHOR AND CONTRIBUTORS ``AS IS'' AND ANY EXPRESS OR IMPLIED WARRANTIES, INCLUDING, BUT NOT
// LIMITED TO, THE IMPLIED WARRANTIES OF MERCHANTABILITY AND FITNESS FOR A PARTICULAR PURPOSE ARE DISCLAIMED. IN NO EVENT SHALL
// THE AUTHOR OR CONTRIBUTORS BE LIABLE FOR ANY DIRECT, INDIRECT, INCIDENTAL, SPECIAL, EXEMPLARY, OR CONSEQUENTIAL DAMAGES
// (INCLUDING, BUT NOT LIMITED TO, PROCUREMENT OF SUBSTITUTE GOODS OR SERVICES; LOSS OF USE, DATA, OR PROFITS; OR BUSINESS
// INTERRUPTION) HOWEVER CAUSED AND ON ANY THEORY OF LIABILITY, WHETHER IN CONTRACT, STRICT LIABILITY, OR TORT (INCLUDING
// NEGLIGENCE OR OTHERWISE) ARISING IN ANY WAY OUT OF THE USE OF THIS SOFTWARE, EVEN IF ADVISED OF THE POSSIBILITY OF SUCH
// DAMAGE.

const PI: f32 = 3.14159274;
const TAU: f32 = 6.28318548;
const FRAC_1_PI: f32 = 0.318309873;
const FRAC_PI_2: f32 = 1.57079637;

/// A sum that is rounded as it stands, whatever it is a part of.
fn kept(sum: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(sum) ^ zero);
}

/// The upper 12 bits of a number's 24.
fn upper_half(v: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(v) & 0xfffff000u);
}

/// A product and what its rounding lost, exactly (Dekker 1971), unless the latter is below 2^-126.
fn exact_product(a: f32, b: f32) -> vec2<f32> {
    let p = times(a, b);
    let a_high = upper_half(a);
    let b_high = upper_half(b);
    let a_low = a - a_high;
    let b_low = b - b_high;
    let upper = kept(times(a_high, b_high) - p);
    let middle = kept(kept(upper + times(a_high, b_low)) + times(a_low, b_high));
    return vec2<f32>(p, middle + times(a_low, b_low));
}

/// `x` to the power of `y`, for `x` in [0, 1.09], `y` in [0, 1024]. Results below 2^-126 are 0, and `x` below it counts as
/// 0.
fn pow_unit(x: f32, y: f32) -> f32 {
    // Answer what needs no logarithm.
    if y == 0.0 || x == 1.0 {
        return 1.0;
    }
    if y == 1.0 {
        return x;
    }
    if y == 2.0 {
        return times(x, x);
    }
    if y == 0.5 {
        return root(x);
    }
    if bitcast<i32>(x) < 0x00800000 {
        return 0.0;
    }

    // Scale x into [sqrt(3) / 2, sqrt(3)) by a power of two, and see which of 1 and 1.5 is nearer.
    var n = (bitcast<i32>(x) >> 23u) - 127;
    let fraction = bitcast<u32>(x) & 0x007fffffu;
    var scaled_bits = fraction | 0x3f800000u;
    var is_high = false;
    if fraction > 0x1cc471u {
        if fraction < 0x5db3d7u {
            is_high = true;
        } else {
            n += 1;
            scaled_bits -= 0x00800000u;
        }
    }
    let ax = bitcast<f32>(scaled_bits);
    let base = select(1.0, 1.5, is_high);
    let log_base_high = select(0.0, 0.584960938, is_high);
    let log_base_low = select(0.0, 1.56322085e-6, is_high);

    // Split s = (ax - base) / (ax + base).
    let difference = ax - base;
    let inverse = quotient(1.0, ax + base);
    let s = times(difference, inverse);
    let s_high = upper_half(s);
    let sum_bits = (((scaled_bits >> 1u) & 0xfffff000u) | 0x20000000u) + 0x00400000u + select(0u, 0x00200000u, is_high);
    let sum_high = bitcast<f32>(sum_bits);
    let sum_low = ax - kept(sum_high - base);
    let s_low = times(inverse, kept(difference - times(s_high, sum_high)) - times(s_high, sum_low));

    // Find log(ax) = s (2 + ...).
    let s2 = times(s, s);
    let series = 0.6
        + times(s2, 0.428571433 + times(s2, 0.333333343 + times(s2, 0.272728115
        + times(s2, 0.230660751 + times(s2, 0.20697501)))));
    let r = times(times(s2, s2), series) + times(s_low, s_high + s);
    let s_high2 = times(s_high, s_high);
    let t_high = upper_half(kept(3.0 + s_high2) + kept(r));
    let t_low = kept(r) - kept(kept(t_high - 3.0) - s_high2);
    let log_high = times(s_high, t_high);
    let log_low = times(s_low, t_high) + times(t_low, s);

    // Make it log2(x) = t1 + t2.
    let p_high = upper_half(log_high + kept(log_low));
    let p_low = kept(log_low) - kept(p_high - log_high);
    let z_high = times(0.961914063, p_high);
    let z_low = kept(kept(times(-1.17368574e-4, p_high) + times(p_low, 0.961796701)) + log_base_low);
    let power = f32(n);
    let t1 = upper_half(kept(kept(z_high + z_low) + log_base_high) + power);
    let t2 = z_low - kept(kept(kept(t1 - power) - log_base_high) - z_high);

    // Multiply it by y, split likewise.
    let y1 = upper_half(y);
    let low = kept(times(y - y1, t1) + times(y, kept(t2)));
    var high = times(y1, t1);
    let exponent = low + high;
    if exponent < -127.0 {
        return 0.0;
    }

    // Take the whole number nearest to the exponent out of it.
    let bits = bitcast<i32>(exponent);
    var whole = 0;
    if (bits & 0x7fffffff) > 0x3f000000 {
        let place = u32(((bits & 0x7fffffff) >> 23u) - 126);
        let rounded = bits + (0x00800000 >> place);
        let bits_before_point = u32(((rounded & 0x7fffffff) >> 23u) - 127);
        whole = ((rounded & 0x007fffff) | 0x00800000) >> (23u - bits_before_point);
        whole = select(whole, -whole, bits < 0);
        high = kept(high - bitcast<f32>(rounded & ~(0x007fffff >> bits_before_point)));
    }

    // Raise 2 to the rest, and scale.
    let t = bitcast<f32>(bitcast<u32>(low + high) & 0xffff8000u);
    let u = times(t, 0.693145752);
    let v = kept(times(low - kept(t - high), 0.693147182) + times(t, 1.42860654e-6));
    let z = kept(u + v);
    let w = kept(v - kept(z - u));
    let z2 = times(z, z);
    let even = kept(z - times(z2, 0.166666672
        + times(z2, -0.00277777785 + times(z2, 6.61375598e-5
        + times(z2, -1.65339015e-6 + times(z2, 4.13813694e-8))))));
    let r2 = kept(kept(quotient(times(z, even), even - 2.0)) - kept(w + times(z, w)));
    let raised = 1.0 - kept(r2 - z);
    let result = bitcast<i32>(raised) + (whole << 23u);
    return select(bitcast<f32>(result), 0.0, result < 0x00800000);
}

/// 2^((i - 8) / 16), and what its rounding lost.
const EXP2_HIGH = array<f32, 16>(
    0.70710677, 0.7384131, 0.7711054, 0.80524516, 0.8408964, 0.8781261, 0.91700405, 0.9576033,
    1.0, 1.0442737, 1.0905077, 1.1387886, 1.1892071, 1.2418578, 1.2968396, 1.3542556,
);
const EXP2_LOW = array<f32, 16>(
    1.21016175e-8, -2.2504494e-8, 4.0354524e-9, 4.9181086e-9, -1.2377663e-8, -4.617885e-9, -5.619639e-9, 4.922664e-9,
    0.0, 4.83347e-8, -1.307754e-8, 5.3862223e-8, 3.7976353e-8, 4.496838e-8, -4.0189995e-8, -1.0123349e-8,
);

/// 2 to the power of `x` <= 0; results below 2^-126 are 0. Of all other arguments 6,146 give a result one unit in the last place beside
/// libm's, and for 1,870 of them that shows in a highlight's `2^(-e / 2) + e`.
fn exp2_nonpositive(x: f32) -> f32 {
    if x < -126.0 {
        return 0.0;
    }

    // Split x = whole + (i - 8) / 16 + z with |z| <= 1 / 32: behind 786432 = 2^19.6 is place for 4 binary places.
    let shifted = kept(x + 786432.0);
    let index = bitcast<u32>(shifted) + 8u;
    let whole = i32(index >> 4u) - 0x04940000;
    let z = x - kept(shifted - 786432.0);

    // Find 2^z - 1, its linear term exactly.
    let linear = exact_product(z, 0.6931472);
    let rest = times(times(z, z), 0.2402265 + times(z, 0.05550541 + times(z, 0.009618355))) + linear.y;

    // Multiply the table's number by it, keeping what is lost.
    let high = EXP2_HIGH[index & 15u];
    let low = EXP2_LOW[index & 15u];
    let product = exact_product(high, linear.x);
    let sum = kept(high + product.x);
    let lost = product.x - kept(sum - high);
    let tail = lost + kept(kept(product.y + times(low, 1.0 + linear.x)) + times(high, rest));
    return bitcast<f32>(bitcast<i32>(sum + tail) + (whole << 23u));
}

/// The angle of the point (`x`, `y`), in [-pi, pi]; 0 for a point that is nowhere. A coordinate below 2^-126 counts as 0.
fn atan2f(y: f32, x: f32) -> f32 {
    let x_bits = bitcast<u32>(x);
    let y_bits = bitcast<u32>(y);
    let x_size = x_bits & 0x7fffffffu;
    let y_size = y_bits & 0x7fffffffu;
    let x_is_negative = x_bits > 0x7fffffffu;
    let y_is_negative = y_bits > 0x7fffffffu;

    // Answer on the axes, and within 2^-26 of the vertical one.
    if x_bits == 0x3f800000u {
        return atanf(y);
    }
    if y_size < 0x00800000u {
        return select(y, select(PI, -PI, y_is_negative), x_is_negative);
    }
    if x_size < 0x00800000u || x_size + 0x0d000000u < y_size {
        return select(FRAC_PI_2, -FRAC_PI_2, y_is_negative);
    }

    // Find the angle between the line and the horizontal axis.
    var angle = 0.0;
    if !(x_is_negative && y_size + 0x0d000000u < x_size) {
        angle = atanf(abs(quotient(y, x)));
    }

    // Turn it into its quadrant.
    if x_is_negative {
        angle = PI - kept(angle + 8.74227766e-8);
    }
    return select(angle, -angle, y_is_negative);
}

/// The angle of slope `x`.
fn atanf(x: f32) -> f32 {
    // Answer where the slope is the angle, and where the angle is a right one.
    let size = bitcast<u32>(x) & 0x7fffffffu;
    if size < 0x39800000u {
        return x;
    }
    if size >= 0x4c800000u {
        return select(1.57079625, -1.57079625, x < 0.0);
    }

    // Turn the line by the nearest of five angles: none, and those of slope 1/2, 1, 3/2 and infinity.
    let steep = abs(x);
    var reduced = x;
    var turned_high = 0.0;
    var turned_low = 0.0;
    if size >= 0x401c0000u {
        reduced = quotient(-1.0, steep);
        turned_high = 1.57079625;
        turned_low = 7.54978942e-8;
    } else if size >= 0x3f980000u {
        reduced = quotient(steep - 1.5, 1.0 + times(1.5, steep));
        turned_high = 0.982793689;
        turned_low = 3.44732172e-8;
    } else if size >= 0x3f300000u {
        reduced = quotient(steep - 1.0, steep + 1.0);
        turned_high = 0.785398126;
        turned_low = 3.77489471e-8;
    } else if size >= 0x3ee00000u {
        reduced = quotient(times(2.0, steep) - 1.0, 2.0 + steep);
        turned_high = 0.463647604;
        turned_low = 5.01215824e-9;
    }

    // Add the series, its odd and even terms apart.
    let z = times(reduced, reduced);
    let w = times(z, z);
    let odd = times(z, 0.333333284 + times(w, 0.142536357 + times(w, 0.0616876073)));
    let even = times(w, -0.199991584 + times(w, -0.106480174));
    let product = times(reduced, odd + even);
    if size < 0x3ee00000u {
        return x - product;
    }
    let angle = turned_high - kept(kept(product - turned_low) - reduced);
    return select(angle, -angle, x < 0.0);
}

/// The angle of cosine `x`, which is in [-1, 1].
fn acosf(x: f32) -> f32 {
    // Answer at the ends and in the middle. (libm's right angle is rounded down here.)
    let size = bitcast<u32>(x) & 0x7fffffffu;
    if size >= 0x3f800000u {
        return select(0.0, 2.0 * 1.57079625, x < 0.0);
    }
    if size <= 0x32800000u {
        return 1.57079625;
    }

    // Near a right angle, take it from that.
    if size < 0x3f000000u {
        let product = times(x, acos_series(times(x, x)));
        return 1.57079625 - kept(x - kept(7.54978942e-8 - product));
    }

    // Elsewhere go by half the angle.
    let z = times(1.0 - abs(x), 0.5);
    let s = root(z);
    if x < 0.0 {
        let w = times(acos_series(z), s) - 7.54978942e-8;
        return 2.0 * (1.57079625 - kept(s + kept(w)));
    }
    let s_high = upper_half(s);
    let s_low = quotient(z - times(s_high, s_high), s + s_high);
    let w = times(acos_series(z), s) + kept(s_low);
    return 2.0 * (s_high + kept(w));
}

/// What the arc sine of x differs by from x, over x, for z = x^2 <= 1/4.
fn acos_series(z: f32) -> f32 {
    let p = times(z, 0.166665867 + times(z, -0.0427434221 + times(z, -0.0086563630)));
    return quotient(p, 1.0 + times(z, -0.70662963));
}
