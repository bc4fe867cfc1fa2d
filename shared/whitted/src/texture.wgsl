// Sibling of texture.rs.
//
// `texture_at`, `texel_word` and `srgb_linear` read the pack: its texture records, its texels, and the table of
// `tessera_pack::color`.

// `tessera_pack::Wrap`.
const WRAP_REPEAT: u32 = 0u;
const WRAP_MIRROR: u32 = 1u;
const WRAP_CLAMP: u32 = 2u;

/// How texels code their colour: red, green and blue are sRGB codes, or plain numbers.
const CODING_SRGB: u32 = 0u;
const CODING_LINEAR: u32 = 1u;

/// How a look-up treats coordinates outside [0, 1) and between texels.
struct Sampling {
    wrap_s: u32,
    wrap_t: u32,
    nearest: bool,
}

/// Unpacks `sampling` of a texture: bits 0..1 wrap along s, 2..3 along t, bit 4 nearest.
fn sampling_of(image: Texture) -> Sampling {
    let bits = image.sampling;
    return Sampling(min(bits & 3u, WRAP_CLAMP), min((bits >> 2u) & 3u, WRAP_CLAMP), (bits & 16u) != 0u);
}

/// The four texels around a point, and how far it lies from the upper left one.
struct Footprint {
    texel: vec4<u32>,
    across: f32,
    down: f32,
}

/// Colour (x, y, z) and alpha (w) of texture `index` at `uv`: (0, 0) is the image's upper left corner, texel centres
/// lie at + 0.5.
fn lookup(index: u32, uv: vec2<f32>, coding: u32) -> vec4<f32> {
    return lookup_as(index, sampling_of(texture_at(index)), uv, coding);
}

/// `lookup` with another sampling than the texture's own.
fn lookup_as(index: u32, sampling: Sampling, uv: vec2<f32>, coding: u32) -> vec4<f32> {
    let f = footprint(index, sampling, uv);
    let a = color_of(f.texel.x, coding);
    let b = color_of(f.texel.y, coding);
    let c = color_of(f.texel.z, coding);
    let d = color_of(f.texel.w, coding);
    let color = lerp(lerp(a, b, f.across), lerp(c, d, f.across), f.down);
    return vec4<f32>(color, blend_alpha(f));
}

/// The alpha of `lookup` alone, bit for bit.
fn lookup_alpha(index: u32, uv: vec2<f32>) -> f32 {
    return blend_alpha(footprint(index, sampling_of(texture_at(index)), uv));
}

fn footprint(index: u32, sampling: Sampling, uv: vec2<f32>) -> Footprint {
    // Find the neighbours on each axis.
    let image = texture_at(index);
    let x = neighbours(uv.x, image.width, sampling.wrap_s, sampling.nearest);
    let y = neighbours(uv.y, image.height, sampling.wrap_t, sampling.nearest);

    // Fetch them; a pack's texel section covers every texture, so the index is in range.
    let upper = image.first_texel + y.low * image.width;
    let lower = image.first_texel + y.high * image.width;
    let texel = vec4<u32>(
        texel_word(upper + x.low),
        texel_word(upper + x.high),
        texel_word(lower + x.low),
        texel_word(lower + x.high),
    );
    return Footprint(texel, x.share, y.share);
}

fn color_of(texel: u32, coding: u32) -> vec3<f32> {
    let code = vec3<u32>(texel & 255u, (texel >> 8u) & 255u, (texel >> 16u) & 255u);
    if coding == CODING_SRGB {
        return vec3<f32>(srgb_linear(code.x), srgb_linear(code.y), srgb_linear(code.z));
    }
    return scaled(vec3<f32>(code), 1.0 / 255.0);
}

/// The texels on both sides of a point on an axis, and the share of the second.
struct Neighbours {
    low: u32,
    high: u32,
    share: f32,
}

/// Those of `coordinate` on an axis of `size` texels.
fn neighbours(coordinate: f32, size: u32, wrap: u32, nearest: bool) -> Neighbours {
    // Bring the coordinate into [0, 1]. Where f32 has no fractions left the difference is 0. (`kept`: a fraction that
    // rounds to 1 stays 1, which a device's `fract` may not grant.)
    var folded = coordinate;
    if wrap == WRAP_REPEAT {
        folded = coordinate - kept(floor(coordinate));
    } else if wrap == WRAP_MIRROR {
        let two = coordinate - times(2.0, floor(times(coordinate, 0.5)));
        folded = select(two, 2.0 - two, two > 1.0);
    }

    // What is no number is told by its bits, and taken as on the CPU: the end of a clamped axis if it is +infinity,
    // else 0.
    if !is_number(coordinate) {
        folded = select(0.0, 1.0, wrap == WRAP_CLAMP && bitcast<u32>(coordinate) == 0x7f800000u);
    }
    var at = 0.0;
    if folded > 0.0 {
        at = times(min(folded, 1.0), f32(size));
    }

    // Take the texel that holds the point; 1.0 itself belongs to the last.
    let last = size - 1u;
    if nearest {
        let texel = min(u32(at), last);
        return Neighbours(texel, texel, 0.0);
    }

    // Or the two whose centres enclose it; beyond the border comes the other end when repeating, else the same texel
    // again.
    let from_centre = at - 0.5;
    let below_it = kept(floor(from_centre));
    let repeats = wrap == WRAP_REPEAT;
    let before = select(0u, last, repeats);
    let after = select(last, 0u, repeats);
    let first = u32(max(below_it, 0.0));
    var low = min(first, last);
    var high = select(first + 1u, after, first >= last);
    if below_it < 0.0 {
        // (first is -1, and the texel after it 0.)
        low = before;
        high = 0u;
    }
    return Neighbours(low, high, from_centre - below_it);
}

fn blend_alpha(f: Footprint) -> f32 {
    let alpha = vec4<f32>(f.texel >> vec4<u32>(24u));
    let a = times(alpha.x, 1.0 / 255.0);
    let b = times(alpha.y, 1.0 / 255.0);
    let c = times(alpha.z, 1.0 / 255.0);
    let d = times(alpha.w, 1.0 / 255.0);
    let top = a + times(b - a, f.across);
    let bottom = c + times(d - c, f.across);
    return top + times(bottom - top, f.down);
}

fn lerp(a: vec3<f32>, b: vec3<f32>, t: f32) -> vec3<f32> {
    return a + scaled(b - a, t);
}
