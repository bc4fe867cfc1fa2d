// Sibling of path.rs, whose head says how a path ends: the rays of one sample, depth first, without recursion.

/// 1/512: the weight in a pixel below which a ray is not traced.
const MIN_WEIGHT: f32 = 0.001953125;
const MAX_LAYERS: u32 = 64u;

/// A ray that waits to be traced.
struct Segment {
    origin: vec3<f32>,
    after_t: f32,
    direction: vec3<f32>,
    after_triangle: u32,
    weight: vec3<f32>,
    /// Mirror and bent rays before it in bits 0..=7, layers passed straight from 8 on.
    depth_layers: u32,
}

/// What one ray from the eye sees. `first` is the first surface that covers anything.
struct Seen {
    color: vec3<f32>,
    alpha: f32,
    first: Hit,
}

/// Rays traced: primary, shadow, reflection, refraction.
var<private> counts: vec4<u32>;

/// The waiting rays; the one that was put off last is kept apart, so that a scene with one ray behind another needs no memory for more.
/// PATH_STACK is their greatest number, see variant.rs.
var<private> waiting_segments: array<Segment, PATH_STACK>;
var<private> waiting_count: u32;
var<private> next_segment: Segment;

/// Adds a ray unless its weight is too small to be seen; says how many were added.
fn push_segment(segment: Segment) -> u32 {
    if max_element(segment.weight) < MIN_WEIGHT { return 0u; }
    if PATH_STACK > 1u && waiting_count > 0u { waiting_segments[waiting_count - 1u] = next_segment; }
    next_segment = segment;
    waiting_count += 1u;
    return 1u;
}

/// Takes the ray that was put off last; there is one.
fn pop_segment() -> Segment {
    let segment = next_segment;
    waiting_count -= 1u;
    if PATH_STACK > 1u && waiting_count > 0u { next_segment = waiting_segments[waiting_count - 1u]; }
    return segment;
}

fn query_of(segment: Segment) -> Query {
    let is_start = segment.after_triangle == NO_TRIANGLE;
    let t_min = select(below(segment.after_t), segment.after_t, is_start);
    return Query(Ray(segment.origin, t_min, segment.direction, FAR), segment.after_t, segment.after_triangle, LOOK);
}

/// Follows one ray from the eye, and everything behind it.
fn trace(eye: Ray) -> Seen {
    counts.x += 1u;
    var seen = Seen(vec3<f32>(0.0), 1.0, Hit(FAR, NO_TRIANGLE, 0.0, 0.0));
    waiting_count = 1u;
    next_segment = Segment(eye.origin, 0.0, eye.direction, NO_TRIANGLE, vec3<f32>(1.0), 0u);
    loop {
        if waiting_count == 0u { break; }
        let segment = pop_segment();
        let query = query_of(segment);
        let hit = search(query, false);
        record(query, hit);
        if hit.triangle == NO_TRIANGLE {
            leave(&seen, segment);
        } else {
            meet(&seen, segment, hit);
        }
    }
    return seen;
}

/// The ray meets nothing: it sees what lies behind everything.
fn leave(seen: ptr<function, Seen>, segment: Segment) {
    (*seen).color += times3(segment.weight, radiance(segment.direction));
    if (segment.depth_layers & 255u) == 0u && backdrop_is_none() {
        (*seen).alpha = 1.0 - max_element(segment.weight);
    }
}

/// The ray meets a surface.
fn meet(seen: ptr<function, Seen>, segment: Segment, hit: Hit) {
    let direction = segment.direction;
    let depth = segment.depth_layers & 255u;
    let layers = segment.depth_layers >> 8u;
    let surface = surface_at(hit, direction);
    let paint = paint_at(hit);
    let terms = terms_of(paint, surface, direction);

    // What covers nothing is not the surface that is seen.
    if depth == 0u && (*seen).first.triangle == NO_TRIANGLE && paint.alpha > 0.0 { (*seen).first = hit; }
    let covered = scaled(segment.weight, paint.alpha);
    if any(covered != vec3<f32>(0.0)) { (*seen).color += times3(covered, local_light(hit, direction, surface, terms)); }

    // Go straight on past the uncovered part and through unbent glass.
    if SEES_THROUGH {
        var straight = scaled(segment.weight, 1.0 - paint.alpha);
        if !terms.is_bent { straight += times3(covered, terms.passed); }
        if layers < MAX_LAYERS {
            counts.w += push_segment(
                Segment(segment.origin, hit.t, direction, hit.triangle, straight, segment.depth_layers + 256u),
            );
        }
    }
    if depth >= frame.max_depth { return; }

    // Go through bent glass.
    let after_t = clearance(surface);
    let deeper = segment.depth_layers + 1u;
    if HAS_GLASS && terms.is_bent {
        let origin = offset_origin(surface, -surface.facing);
        counts.w += push_segment(Segment(origin, after_t, terms.bent, NO_TRIANGLE, times3(covered, terms.passed), deeper));
    }

    // Follow the mirror.
    if (HAS_MIRRORS || HAS_GLASS) && any(terms.mirror != vec3<f32>(0.0)) {
        let origin = offset_origin(surface, surface.facing);
        let mirrored = reflect_at(direction, surface);
        counts.z += push_segment(Segment(origin, after_t, mirrored, NO_TRIANGLE, times3(covered, terms.mirror), deeper));
    }
}

/// The nearest surface that is seen along a ray from the eye and covers anything.
fn first_seen(eye: Ray) -> Hit {
    var query = Query(eye, 0.0, NO_TRIANGLE, LOOK);
    for (var i = 0u; i <= MAX_LAYERS; i++) {
        let hit = search(query, false);
        if hit.triangle == NO_TRIANGLE || !SEES_THROUGH || paint_at(hit).alpha > 0.0 { return hit; }
        query.after_t = hit.t;
        query.after_triangle = hit.triangle;
        query.ray.t_min = below(hit.t);
    }
    return Hit(FAR, NO_TRIANGLE, 0.0, 0.0);
}
