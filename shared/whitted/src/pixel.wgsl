// Sibling of pixel.rs: blocks of pixels, a work-group each; or pixels whose samples wavefront.wgsl takes step by step.

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
    let at = at_in_job(job, group.x, index);
    if at.x >= job.width || at.y >= job.height { return; }
    render_pixel(job, at, group.y);
    if loops_are_cut() { note_cut_loops(); }
}

/// Whether the driver ends loops before their time: Mesa's software drivers let those of a kernel take 65,535 turns in all, then one each. A
/// loop that should take three turns shows it.
fn loops_are_cut() -> bool {
    var turns = 0u;
    loop {
        if turns >= 3u + zero { break; }
        turns += 1u;
    }
    return turns < 3u;
}

/// Behind the counts of the jobs.
const CUT_LOOPS: u32 = 1024u;

fn note_cut_loops() {
    atomicOr(&ray_counts[CUT_LOOPS], 1u);
}

/// Column and row of a pixel of the job's block `block`: along a Z-curve, so that any 4, 8, 16 or 32 rays that take their steps together
/// are as near to a square as can be.
fn at_in_job(job: Job, block: u32, index: u32) -> vec2<u32> {
    let columns = (job.width + GROUP_SIDE - 1u) / GROUP_SIDE;
    let local = vec2<u32>(even_bits(index), even_bits(index >> 1u));
    return vec2<u32>(block % columns, block / columns) * GROUP_SIDE + local;
}

/// Bits 0, 2 and 4, pushed together.
fn even_bits(index: u32) -> u32 {
    return (index & 1u) | ((index >> 1u) & 2u) | ((index >> 2u) & 4u);
}

fn render_pixel(job: Job, at: vec2<u32>, job_index: u32) {
    counts = vec4<u32>(0u);
    let pixel = vec2<u32>(job.x, job.y) + at;
    let place = at.y * job.width + at.x;
    let seed = pixel_seed(frame.seed_low, frame.seed_high, pixel.x, pixel.y);
    var sum = no_sum();
    if job.first_sample > job.round_first { sum = load_sum(place); }
    var i = job.first_sample;
    loop {
        let seen = trace(sample_ray(pixel, seed, i), i == CENTRE);
        sum = add_sample(sum, seen, i);
        i = sample_after(job, i);
        if i == NO_SAMPLE { break; }
    }
    add_counts(job_index);
    if job.end_sample == job.round_end {
        write_pixel(job.at_pixels + place * pixel_words(frame.format), mean(sum));
    } else {
        store_sum(place, sum);
    }
}

fn no_sum() -> Seen {
    return Seen(vec3<f32>(0.0), 0.0, Hit(FAR, NO_TRIANGLE, 0.0, 0.0));
}

/// Not a sample of those that are added up, but the ray through the pixel's centre that finds the surface which the layers show.
const CENTRE: u32 = 0xffffffffu;
const NO_SAMPLE: u32 = 0xfffffffeu;

/// What comes after sample `i` of a job. One sample goes through the centre itself; of many one ray more does, once a pixel.
fn sample_after(job: Job, i: u32) -> u32 {
    if i == CENTRE { return NO_SAMPLE; }
    if i + 1u < job.end_sample { return i + 1u; }
    let is_first_round = job.end_sample == job.round_end && job.round_first == 0u;
    return select(NO_SAMPLE, CENTRE, is_first_round && frame.format == FORMAT_LAYERS && frame.samples > 1u);
}

/// The ray of sample `i`.
fn sample_ray(pixel: vec2<u32>, seed: u32, i: u32) -> Ray {
    let camera = LocalCamera(frame.eye, frame.forward, frame.right, frame.up);
    let size = vec2<f32>(f32(frame.width), f32(frame.height));
    // (Only samples below the count have a place: of another one the search for it need not end.)
    var offset = vec2<f32>(0.5);
    if i < frame.samples { offset = offset_in_pixel(i, frame.samples, seed); }
    return camera_ray(camera, vec2<f32>(pixel) + offset, size);
}

/// The sum with sample `i`; samples are added up in their order.
fn add_sample(sum: Seen, sample: Seen, i: u32) -> Seen {
    if i == CENTRE { return Seen(sum.color, sum.alpha, sample.first); }
    return Seen(sum.color + sample.color, sum.alpha + sample.alpha, sample.first);
}

/// What the samples of a pixel have seen on the average; the sum itself where the host adds up rounds.
fn mean(sum: Seen) -> Seen {
    if frame.samples <= 1u || frame.is_adaptive != 0u { return sum; }
    let share = quotient(1.0, f32(frame.samples));
    return Seen(sum.color * share, sum.alpha * share, sum.first);
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
