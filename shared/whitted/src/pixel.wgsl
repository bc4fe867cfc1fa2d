// Sibling of pixel.rs: blocks of pixels, a work-group each.

/// Words of a pixel: codes; or linear colour, premultiplied, and alpha; or the layers of pixel.rs.
fn pixel_words(format: u32) -> u32 {
    return select(select(1u, 4u, format == FORMAT_RGBA16), 9u, format == FORMAT_LAYERS);
}

/// Columns and rows of a work-group: 64 rays that begin beside each other.
const GROUP_SIDE: u32 = 8u;

@compute @workgroup_size(64)
fn render(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    zero = frame.zero;
    let job = jobs[group.y];
    let columns = (job.width + GROUP_SIDE - 1u) / GROUP_SIDE;
    // Along a Z-curve, so that any 4, 8, 16 or 32 rays that take their steps together are as near to a square as can be.
    let local = vec2<u32>(even_bits(index), even_bits(index >> 1u));
    let at = vec2<u32>(group.x % columns, group.x / columns) * GROUP_SIDE + local;
    if at.x >= job.width || at.y >= job.height { return; }
    render_pixel(job, vec2<u32>(job.x, job.y) + at, at.y * job.width + at.x, group.y);
}

/// Bits 0, 2 and 4, pushed together.
fn even_bits(index: u32) -> u32 {
    return (index & 1u) | ((index >> 1u) & 2u) | ((index >> 2u) & 4u);
}

fn render_pixel(job: Job, pixel: vec2<u32>, place: u32, job_index: u32) {
    counts = vec4<u32>(0u);
    let camera = LocalCamera(frame.eye, frame.forward, frame.right, frame.up);
    let size = vec2<f32>(f32(frame.width), f32(frame.height));
    let corner = vec2<f32>(pixel);
    let of_layers = frame.format == FORMAT_LAYERS;
    var sum = Seen(vec3<f32>(0.0), 0.0, Hit(FAR, NO_TRIANGLE, 0.0, 0.0));
    if job.first_sample > 0u { sum = load_sum(job.at_sums + place); }
    let seed = pixel_seed(frame.seed_low, frame.seed_high, pixel.x, pixel.y);
    let is_last = job.end_sample == frame.samples;

    // Add the samples up in their order. One goes through the centre; of many one more does, to find the surface that the layers show.
    var end = job.end_sample;
    if is_last && of_layers && frame.samples > 1u { end += 1u; }
    for (var i = job.first_sample; i < end; i++) {
        let only_first = i == frame.samples;
        let offset = select(offset_in_pixel(i, frame.samples, seed), vec2<f32>(0.5), only_first);
        let seen = trace(camera_ray(camera, corner + offset, size), only_first);
        if !only_first {
            sum.color += seen.color;
            sum.alpha += seen.alpha;
        }
        sum.first = seen.first;
    }
    if !is_last {
        store_sum(job.at_sums + place, sum);
        add_counts(job_index);
        return;
    }
    if frame.samples > 1u {
        let share = quotient(1.0, f32(frame.samples));
        sum.color *= share;
        sum.alpha *= share;
    }
    add_counts(job_index);
    write_pixel(job.at_pixels + place * pixel_words(frame.format), sum);
}

fn write_pixel(at: u32, seen: Seen) {
    if frame.format == FORMAT_RGBA8 {
        pixels[at] = straight_codes(seen);
        return;
    }
    pixels[at] = bitcast<u32>(seen.color.x);
    pixels[at + 1u] = bitcast<u32>(seen.color.y);
    pixels[at + 2u] = bitcast<u32>(seen.color.z);
    pixels[at + 3u] = bitcast<u32>(seen.alpha);
    if frame.format == FORMAT_LAYERS {
        var depth = 0x7f800000u;
        var normal = vec3<f32>(0.0);
        var id = NO_TRIANGLE;
        if seen.first.triangle != NO_TRIANGLE {
            let corners = corners_of(seen.first.triangle);
            depth = bitcast<u32>(world_length(seen.first.t));
            normal = geometric_normal(corners.a, corners.b, corners.c);
            id = original_id(seen.first.triangle);
        }
        pixels[at + 4u] = depth;
        pixels[at + 5u] = bitcast<u32>(normal.x);
        pixels[at + 6u] = bitcast<u32>(normal.y);
        pixels[at + 7u] = bitcast<u32>(normal.z);
        pixels[at + 8u] = id;
    }
}

/// sRGB codes of the colour behind the premultiplied one, and of alpha: RGBA, red in bits 0..=7.
fn straight_codes(seen: Seen) -> u32 {
    var color = vec3<f32>(0.0);
    if seen.alpha > 0.0 { color = quotient3(seen.color, vec3<f32>(seen.alpha)); }
    return encode_srgb(color.x) | (encode_srgb(color.y) << 8u) | (encode_srgb(color.z) << 16u) | (encode_linear(seen.alpha) << 24u);
}

fn load_sum(at: u32) -> Seen {
    let v = sums[at];
    return Seen(v.xyz, v.w, Hit(FAR, NO_TRIANGLE, 0.0, 0.0));
}

fn store_sum(at: u32, sum: Seen) {
    sums[at] = vec4<f32>(sum.color, sum.alpha);
}

/// Adds this pixel's rays to those of its job.
fn add_counts(job_index: u32) {
    if counts.x > 0u { atomicAdd(&ray_counts[job_index * 4u], counts.x); }
    if counts.y > 0u { atomicAdd(&ray_counts[job_index * 4u + 1u], counts.y); }
    if counts.z > 0u { atomicAdd(&ray_counts[job_index * 4u + 2u], counts.z); }
    if counts.w > 0u { atomicAdd(&ray_counts[job_index * 4u + 3u], counts.w); }
}
