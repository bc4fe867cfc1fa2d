// Single rays, and the rays behind single pixels: for tests and tools. The twin of probe.rs in whitted.

@group(0) @binding(PROBE_INPUT) var<storage, read> probe_input: array<u32>;
@group(0) @binding(PROBE_OUTPUT) var<storage, read_write> probe_output: array<u32>;

/// Words of a recorded ray.
const PROBE_WORDS: u32 = 12u;

/// Where the next ray is recorded, how many more are, how many there were, and the hash of all.
var<private> probe_at: u32;
var<private> probe_left: u32;
var<private> probe_count: u32;
var<private> probe_hash: u32;

/// Notes a ray and what it hit.
fn record(query: Query, hit: Hit) {
    // Of a ray that asks for anything opaque only the answer counts, not which triangle came first.
    let is_asking = query.kind == OPAQUE;
    let is_hit = hit.triangle != NO_TRIANGLE;
    let triangle = select(hit.triangle, 0u, is_asking && is_hit);
    let t = select(0.0, hit.t, is_hit && !is_asking);
    let t_min = select(query.after_t, query.ray.t_min, query.after_triangle == NO_TRIANGLE);
    probe_count += 1u;
    probe_hash = (probe_hash ^ query.kind) * 0x01000193u;
    probe_hash = (probe_hash ^ triangle) * 0x01000193u;
    if probe_left == 0u { return; }
    let o = query.ray.origin;
    let d = query.ray.direction;
    probe_output[probe_at] = bitcast<u32>(o.x);
    probe_output[probe_at + 1u] = bitcast<u32>(o.y);
    probe_output[probe_at + 2u] = bitcast<u32>(o.z);
    probe_output[probe_at + 3u] = bitcast<u32>(t_min);
    probe_output[probe_at + 4u] = bitcast<u32>(d.x);
    probe_output[probe_at + 5u] = bitcast<u32>(d.y);
    probe_output[probe_at + 6u] = bitcast<u32>(d.z);
    probe_output[probe_at + 7u] = bitcast<u32>(query.ray.t_max);
    probe_output[probe_at + 8u] = query.after_triangle;
    probe_output[probe_at + 9u] = query.kind;
    probe_output[probe_at + 10u] = triangle;
    probe_output[probe_at + 11u] = bitcast<u32>(t);
    probe_at += PROBE_WORDS;
    probe_left -= 1u;
}

/// A path before its first step, between two, and behind its last one.
const PATH_NEW: u32 = 0u;
const PATH_UNDER_WAY: u32 = 1u;
const PATH_ENDED: u32 = 2u;

/// Takes a step of each path. Input: pixels, rays to record of each, sample; then x and y of each pixel. Output for each: rays, hash, how far
/// it is, the rays. Between the steps a path is kept as in wavefront.wgsl: all steps of a long one would be too many loops for some drivers.
@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3<u32>) {
    zero = frame.zero;
    if id.x >= probe_input[0] { return; }
    let kept = probe_input[1];
    let sample = probe_input[2];
    let start = id.x * (3u + PROBE_WORDS * kept);
    let phase = probe_output[start + 2u];
    if phase == PATH_ENDED { return; }
    state = id.x;
    if phase == PATH_NEW {
        probe_count = 0u;
        probe_hash = 0x811c9dc5u;
        counts = vec4<u32>(0u);
        let pixel = vec2<u32>(probe_input[3u + 2u * id.x], probe_input[4u + 2u * id.x]);
        let seed = pixel_seed(frame.seed_low, frame.seed_high, pixel.x, pixel.y);
        begin_path(sample_ray(pixel, seed, sample), false);
        store_path(sample, LOOK);
    } else {
        probe_count = probe_output[start];
        probe_hash = probe_output[start + 1u];
        load_asked();
        load_path();
    }
    probe_at = start + 3u + PROBE_WORDS * min(probe_count, kept);
    probe_left = kept - min(probe_count, kept);
    let kind = asked.kind;
    let hit = search(asked, kind == OPAQUE);
    record(asked, hit);
    let goes_on = step_path(hit);
    if goes_on {
        store_asked(id.x);
        store_path(sample, kind);
    }
    probe_output[start] = probe_count;
    probe_output[start + 1u] = probe_hash;
    probe_output[start + 2u] = select(PATH_ENDED, PATH_UNDER_WAY, goes_on);
    if loops_are_cut() { probe_output[arrayLength(&probe_output) - 1u] = 1u; }
    // What is seen must not be optimised away with the rays behind it.
    if seen.alpha < -1.0 { pixels[0] = bitcast<u32>(seen.color.x); }
}

/// Input: rays, whether any hit will do, then 8 words of each: origin, t_min, direction, t_max. Output for each: t, triangle, b1, b2.
@compute @workgroup_size(64)
fn trace_rays(@builtin(global_invocation_id) id: vec3<u32>) {
    zero = frame.zero;
    if id.x >= probe_input[0] { return; }
    let at = 2u + 8u * id.x;
    let ray = Ray(
        bitcast<vec3<f32>>(vec3<u32>(probe_input[at], probe_input[at + 1u], probe_input[at + 2u])),
        bitcast<f32>(probe_input[at + 3u]),
        bitcast<vec3<f32>>(vec3<u32>(probe_input[at + 4u], probe_input[at + 5u], probe_input[at + 6u])),
        bitcast<f32>(probe_input[at + 7u]),
    );
    let hit = search(Query(ray, 0.0, NO_TRIANGLE, BARE), probe_input[1] != 0u);
    probe_output[4u * id.x] = bitcast<u32>(hit.t);
    probe_output[4u * id.x + 1u] = hit.triangle;
    probe_output[4u * id.x + 2u] = bitcast<u32>(hit.b1);
    probe_output[4u * id.x + 3u] = bitcast<u32>(hit.b2);
    if loops_are_cut() { probe_output[arrayLength(&probe_output) - 1u] = 1u; }
}
