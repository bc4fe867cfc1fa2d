// Paths that are taken step by step, all of a kind together (Laine, Karras and Aila 2013): one kernel searches along the rays of a queue,
// the next shades what they met and queues what each path asks next. The steps are those of path.wgsl.
//
// A path at a time is under way in each pixel, so its samples and what they see are added up in the order of pixel.wgsl, and the picture is
// the same. In which place of a queue a ray comes, and which state a pixel gets, is left to chance; nothing depends on it.
//
// A state whose pixel is finished takes the next pixel of the work, so that the queues are short only at its end.
//
// | kernel | does |
// |---|---|
// | `wave_start` | gives every state its first pixel |
// | `wave_turn` | makes the queue that was filled the one to be worked off |
// | `wave_extend` | finds what the rays of the queue meet |
// | `wave_shade` | takes a step of every path in the queue, and fills the other one |

/// Counters of the work, and two queues: while one is worked off the other one is filled.
struct Waves {
    /// States, and blocks of pixels and jobs of the work.
    states: u32,
    blocks: u32,
    jobs: u32,
    /// The queue that is being worked off, 0 or 1, and how many of its rays look for the nearest hit and for any.
    turn: u32,
    nearest: u32,
    any: u32,
    /// The same of the queue that is being filled.
    next_nearest: atomic<u32>,
    next_any: atomic<u32>,
    /// Pixels that have been begun, in the order of the blocks.
    begun: atomic<u32>,
    reserved_a: u32,
    reserved_b: u32,
    reserved_c: u32,
    /// `states` places of each queue: those that look for the nearest hit from the front, those for any from the back.
    queues: array<u32>,
}

@group(0) @binding(WAVE_STATES) var<storage, read_write> quads: array<vec4<u32>>;
@group(0) @binding(WAVE_QUEUES) var<storage, read_write> waves: Waves;
/// Work-groups of the next kernels.
@group(0) @binding(WAVE_GROUPS) var<storage, read_write> wave_groups: array<u32, 3>;

/// Work-groups along the first axis of a dispatch: what every device takes.
const GROUPS_ACROSS: u32 = 65535u;

/// The state at hand.
var<private> state: u32;

// A state is a column of `vec4`s, a row for each of these; a neighbour's lies beside it.
const ROW_ASKED: u32 = 0u;
const ROW_HIT: u32 = 3u;
const ROW_AT_HAND: u32 = 4u;
const ROW_SEEN: u32 = 7u;
const ROW_SEEN_FIRST: u32 = 8u;
const ROW_SUM: u32 = 9u;
const ROW_COUNTS: u32 = 10u;
/// What is kept while lights are asked: of the surface and of the light.
const ROW_VIEW: u32 = 11u;
const ROW_LIGHT: u32 = 21u;
/// Three rows for each ray that waits.
const ROW_WAITING: u32 = 24u;

fn set_row(row: u32, xyz: vec3<f32>, w: u32) {
    quads[row * waves.states + state] = vec4<u32>(bitcast<vec3<u32>>(xyz), w);
}

fn set_numbers(row: u32, xyz: vec3<f32>, w: f32) {
    set_row(row, xyz, bitcast<u32>(w));
}

fn row_at(row: u32) -> vec4<u32> {
    return quads[row * waves.states + state];
}

fn numbers_at(row: u32) -> vec4<f32> {
    return bitcast<vec4<f32>>(row_at(row));
}

fn keep_segment(i: u32, segment: Segment) {
    let row = ROW_WAITING + 3u * i;
    set_numbers(row, segment.origin, segment.after_t);
    set_row(row + 1u, segment.direction, segment.after_triangle);
    set_row(row + 2u, segment.weight, segment.depth_layers);
}

fn kept_segment(i: u32) -> Segment {
    let row = ROW_WAITING + 3u * i;
    let a = row_at(row);
    let b = row_at(row + 1u);
    let c = row_at(row + 2u);
    let origin = bitcast<vec3<f32>>(a.xyz);
    let direction = bitcast<vec3<f32>>(b.xyz);
    return Segment(origin, bitcast<f32>(a.w), direction, b.w, bitcast<vec3<f32>>(c.xyz), c.w);
}

/// Keeps what is asked, of the pixel with a number.
fn store_asked(pixel: u32) {
    set_numbers(ROW_ASKED, asked.ray.origin, asked.ray.t_min);
    set_numbers(ROW_ASKED + 1u, asked.ray.direction, asked.ray.t_max);
    quads[(ROW_ASKED + 2u) * waves.states + state] =
        vec4<u32>(bitcast<u32>(asked.after_t), asked.after_triangle, asked.kind, pixel);
}

/// Takes up what is asked; returns the number of the pixel.
fn load_asked() -> u32 {
    let a = numbers_at(ROW_ASKED);
    let b = numbers_at(ROW_ASKED + 1u);
    let c = row_at(ROW_ASKED + 2u);
    asked = Query(Ray(a.xyz, a.w, b.xyz, b.w), bitcast<f32>(c.x), c.y, c.z);
    return c.w;
}

fn store_hit(hit: Hit) {
    quads[ROW_HIT * waves.states + state] =
        vec4<u32>(bitcast<u32>(hit.t), hit.triangle, bitcast<u32>(hit.b1), bitcast<u32>(hit.b2));
}

fn load_hit(row: u32) -> Hit {
    let v = row_at(row);
    return Hit(bitcast<f32>(v.x), v.y, bitcast<f32>(v.z), bitcast<f32>(v.w));
}

/// Keeps a path whose last question was of `kind`, and sample `i` of its pixel; what cannot have changed is left as it is.
fn store_path(i: u32, kind: u32) {
    quads[ROW_COUNTS * waves.states + state] = counts;
    if asked.kind == LOOK {
        // A new ray is at hand.
        set_row(ROW_AT_HAND, at_hand.origin, at_hand.depth_layers);
        set_row(ROW_AT_HAND + 1u, at_hand.direction, waiting_count);
        set_row(ROW_AT_HAND + 2u, at_hand.weight, i);
        set_numbers(ROW_SEEN, seen.color, seen.alpha);
        if PATH_STACK > 1u && waiting_count > 0u { keep_segment(waiting_count - 1u, next_segment); }
    } else {
        // A light is asked; the first one, or one more.
        set_row(ROW_LIGHT, local_sum, next_light);
        set_row(ROW_LIGHT + 1u, sent_back, layers_passed);
        if SEES_THROUGH { set_row(ROW_LIGHT + 2u, passed, 0u); }
        if kind == LOOK { store_view(); }
    }
    if kind == LOOK && frame.format == FORMAT_LAYERS {
        let first = seen.first;
        quads[ROW_SEEN_FIRST * waves.states + state] =
            vec4<u32>(bitcast<u32>(first.t), first.triangle, bitcast<u32>(first.b1), bitcast<u32>(first.b2));
    }
}

/// Takes up the path that has asked; returns the number of its sample.
fn load_path() -> u32 {
    counts = row_at(ROW_COUNTS);
    let a = row_at(ROW_AT_HAND);
    let b = row_at(ROW_AT_HAND + 1u);
    let c = row_at(ROW_AT_HAND + 2u);
    let origin = bitcast<vec3<f32>>(a.xyz);
    let weight = bitcast<vec3<f32>>(c.xyz);
    // (Where it began is of no use any more.)
    at_hand = Segment(origin, 0.0, bitcast<vec3<f32>>(b.xyz), NO_TRIANGLE, weight, a.w);
    waiting_count = b.w;
    if PATH_STACK > 1u && waiting_count > 0u { next_segment = kept_segment(waiting_count - 1u); }
    let sight = numbers_at(ROW_SEEN);
    seen = Seen(sight.xyz, sight.w, Hit(FAR, NO_TRIANGLE, 0.0, 0.0));
    if frame.format == FORMAT_LAYERS { seen.first = load_hit(ROW_SEEN_FIRST); }
    only_first = c.w == CENTRE;
    if asked.kind != LOOK {
        let light = row_at(ROW_LIGHT);
        let sent = row_at(ROW_LIGHT + 1u);
        local_sum = bitcast<vec3<f32>>(light.xyz);
        next_light = light.w;
        sent_back = bitcast<vec3<f32>>(sent.xyz);
        layers_passed = sent.w;
        if SEES_THROUGH { passed = numbers_at(ROW_LIGHT + 2u).xyz; } else { passed = vec3<f32>(1.0); }
        load_view();
    }
    return c.w;
}

fn store_view() {
    set_numbers(ROW_VIEW, view_surface.at, view_alpha);
    set_numbers(ROW_VIEW + 1u, view_surface.error, view_hit.t);
    set_row(ROW_VIEW + 2u, view_surface.facing, view_hit.triangle);
    set_row(ROW_VIEW + 3u, view_surface.shading, select(0u, 1u, view_terms.is_bent));
    set_numbers(ROW_VIEW + 4u, view_terms.diffuse, view_terms.f90);
    set_numbers(ROW_VIEW + 5u, view_terms.f0, view_terms.exponent);
    set_row(ROW_VIEW + 6u, covered, 0u);
    if HAS_MIRRORS || HAS_GLASS { set_row(ROW_VIEW + 7u, view_terms.mirror, 0u); }
    if HAS_GLASS {
        set_row(ROW_VIEW + 8u, view_terms.passed, 0u);
        set_row(ROW_VIEW + 9u, view_terms.bent, 0u);
    }
}

fn load_view() {
    let at = numbers_at(ROW_VIEW);
    let error = numbers_at(ROW_VIEW + 1u);
    let facing = row_at(ROW_VIEW + 2u);
    let shading = row_at(ROW_VIEW + 3u);
    let diffuse = numbers_at(ROW_VIEW + 4u);
    let f0 = numbers_at(ROW_VIEW + 5u);
    covered = numbers_at(ROW_VIEW + 6u).xyz;
    let none = vec3<f32>(0.0);
    var mirror = none;
    var through = none;
    var bent = none;
    if HAS_MIRRORS || HAS_GLASS { mirror = numbers_at(ROW_VIEW + 7u).xyz; }
    if HAS_GLASS {
        through = numbers_at(ROW_VIEW + 8u).xyz;
        bent = numbers_at(ROW_VIEW + 9u).xyz;
    }
    // (Of what no light and no ray behind the surface needs nothing is kept.)
    view_alpha = at.w;
    view_hit = Hit(error.w, facing.w, 0.0, 0.0);
    view_surface = Surface(at.xyz, error.xyz, bitcast<vec3<f32>>(facing.xyz), bitcast<vec3<f32>>(shading.xyz), true);
    view_terms = Terms(diffuse.xyz, none, none, f0.xyz, diffuse.w, f0.w, mirror, through, shading.w == 1u, bent);
}

/// A pixel of the work: 64 numbers for each block, in the order of the jobs.
struct WavePixel {
    job: u32,
    /// Column and row in its job.
    at: vec2<u32>,
}

fn wave_pixel(number: u32) -> WavePixel {
    // Find the last job that does not begin behind its block.
    let block = number / 64u;
    var low = 0u;
    var high = waves.jobs - 1u;
    loop {
        if low >= high { break; }
        let middle = (low + high + 1u) / 2u;
        if jobs[middle].first_block <= block { low = middle; } else { high = middle - 1u; }
    }
    return WavePixel(low, at_in_job(jobs[low], block - jobs[low].first_block, number % 64u));
}

/// Begins the pixel of a number, or if there is none, as at the edge of a job, the next one that nobody has begun; queues its first ray.
fn begin_pixel(first: u32) {
    var number = first;
    loop {
        if number >= waves.blocks * 64u { return; }
        let pixel = wave_pixel(number);
        let job = jobs[pixel.job];
        if pixel.at.x < job.width && pixel.at.y < job.height {
            counts = vec4<u32>(0u);
            begin_wave_sample(job, pixel, number, job.first_sample);
            return;
        }
        number = atomicAdd(&waves.begun, 1u);
    }
}

fn begin_wave_sample(job: Job, pixel: WavePixel, number: u32, i: u32) {
    let at = vec2<u32>(job.x, job.y) + pixel.at;
    let seed = pixel_seed(frame.seed_low, frame.seed_high, at.x, at.y);
    begin_path(sample_ray(at, seed, i), i == CENTRE);
    store_asked(number);
    store_path(i, LOOK);
    enqueue();
}

/// Ends sample `i` of a pixel, and begins the next one, or another pixel.
fn end_wave_sample(number: u32, i: u32) {
    let pixel = wave_pixel(number);
    let job = jobs[pixel.job];
    var sum = no_sum();
    if i > job.first_sample {
        let v = numbers_at(ROW_SUM);
        sum = Seen(v.xyz, v.w, sum.first);
    }
    sum = add_sample(sum, seen, i);
    let next = sample_after(job, i);
    if next != NO_SAMPLE {
        set_numbers(ROW_SUM, sum.color, sum.alpha);
        begin_wave_sample(job, pixel, number, next);
        return;
    }
    let place = pixel.at.y * job.width + pixel.at.x;
    add_counts(pixel.job);
    write_pixel(job.at_pixels + place * pixel_words(frame.format), mean(sum));
    begin_pixel(atomicAdd(&waves.begun, 1u));
}

/// Puts the state at hand into the queue that is being filled.
fn enqueue() {
    let start = (1u - waves.turn) * waves.states;
    if asked.kind == OPAQUE {
        waves.queues[start + waves.states - 1u - atomicAdd(&waves.next_any, 1u)] = state;
    } else {
        waves.queues[start + atomicAdd(&waves.next_nearest, 1u)] = state;
    }
}

/// Takes the state of a thread from the queue that is being worked off; false when there is none for it. Rays of one kind share groups.
fn take_queued(group: vec3<u32>, index: u32) -> bool {
    let start = waves.turn * waves.states;
    let nearest_groups = (waves.nearest + 63u) / 64u;
    let number = group.y * GROUPS_ACROSS + group.x;
    if number < nearest_groups {
        let i = number * 64u + index;
        if i >= waves.nearest { return false; }
        state = waves.queues[start + i];
    } else {
        let i = (number - nearest_groups) * 64u + index;
        if i >= waves.any { return false; }
        state = waves.queues[start + waves.states - 1u - i];
    }
    return true;
}

@compute @workgroup_size(64)
fn wave_start(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    zero = frame.zero;
    state = (group.y * GROUPS_ACROSS + group.x) * 64u + index;
    if state < waves.states { begin_pixel(state); }
}

@compute @workgroup_size(1)
fn wave_turn() {
    waves.turn = 1u - waves.turn;
    waves.nearest = atomicExchange(&waves.next_nearest, 0u);
    waves.any = atomicExchange(&waves.next_any, 0u);
    let groups = (waves.nearest + 63u) / 64u + (waves.any + 63u) / 64u;
    wave_groups[0] = min(groups, GROUPS_ACROSS);
    wave_groups[1] = (groups + GROUPS_ACROSS - 1u) / GROUPS_ACROSS;
    wave_groups[2] = 1u;
}

@compute @workgroup_size(64)
fn wave_extend(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    zero = frame.zero;
    if !take_queued(group, index) { return; }
    load_asked();
    store_hit(search(asked, asked.kind == OPAQUE));
    if loops_are_cut() { note_cut_loops(); }
}

@compute @workgroup_size(64)
fn wave_shade(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    zero = frame.zero;
    if !take_queued(group, index) { return; }
    let number = load_asked();
    let i = load_path();
    let kind = asked.kind;
    if step_path(load_hit(ROW_HIT)) {
        store_asked(number);
        store_path(i, kind);
        enqueue();
    } else {
        end_wave_sample(number, i);
    }
    if loops_are_cut() { note_cut_loops(); }
}
