// Sibling of path.rs, whose head says how a path ends, and of `local_light` and `transmittance`: the rays of one sample, depth first, in
// the order of the single-ray code. There is one search for all of them, in a loop: rays of neighbouring pixels that look, ask for a light
// or filter it take their steps together, and the kernel holds one traversal and not four.

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

/// The rays that wait to be traced: how many, and the one that was put off last, which is kept apart, so that a scene with one ray behind
/// another needs no memory for more. `keep_segment(i, segment)` and `kept_segment(i)` are of waiting.wgsl or wavefront.wgsl.
var<private> waiting_count: u32;
var<private> next_segment: Segment;

/// Whether a ray, or a light, of this weight is not followed.
fn is_cut_off(weight: vec3<f32>) -> bool {
    let most = max_element(weight);
    return most < frame.cutoff || most == 0.0;
}

/// Adds a ray unless its weight is nothing, or below the frame's cut-off; says how many were added.
fn push_segment(segment: Segment) -> u32 {
    if is_cut_off(segment.weight) { return 0u; }
    if PATH_STACK > 1u && waiting_count > 0u { keep_segment(waiting_count - 1u, next_segment); }
    next_segment = segment;
    waiting_count += 1u;
    return 1u;
}

/// Takes the ray that was put off last; there is one.
fn pop_segment() -> Segment {
    let segment = next_segment;
    waiting_count -= 1u;
    if PATH_STACK > 1u && waiting_count > 0u { next_segment = kept_segment(waiting_count - 1u); }
    return segment;
}

fn query_of(segment: Segment) -> Query {
    let is_start = segment.after_triangle == NO_TRIANGLE;
    let t_min = select(below(segment.after_t), segment.after_t, is_start);
    return Query(Ray(segment.origin, t_min, segment.direction, FAR), segment.after_t, segment.after_triangle, LOOK);
}

/// The ray from the eye, a mirror or glass that is at hand, what is asked along it or of its lights, and what has been seen so far.
var<private> at_hand: Segment;
var<private> asked: Query;
var<private> seen: Seen;
/// Whether the first surface is all that is to be seen.
var<private> only_first: bool;

/// What the ray that is at hand met last, while its lights are asked one by one.
var<private> view_hit: Hit;
var<private> view_surface: Surface;
var<private> view_terms: Terms;
var<private> view_alpha: f32;
/// The weight of its own light, what has come together of it, and the light to be asked next.
var<private> covered: vec3<f32>;
var<private> local_sum: vec3<f32>;
var<private> next_light: u32;
/// What the light that is being asked sends back, and the share of it that the surfaces before let through.
var<private> sent_back: vec3<f32>;
var<private> passed: vec3<f32>;
var<private> layers_passed: u32;

/// Follows one ray from the eye, and everything behind it; or, of a ray that is to show its first surface only, as far as that.
fn trace(eye: Ray, shows_first: bool) -> Seen {
    begin_path(eye, shows_first);
    loop {
        let hit = search(asked, asked.kind == OPAQUE);
        record(asked, hit);
        if !step_path(hit) { break; }
    }
    return seen;
}

/// Asks for the first surface along a ray from the eye.
fn begin_path(eye: Ray, shows_first: bool) {
    counts.x += 1u;
    only_first = shows_first;
    seen = Seen(vec3<f32>(0.0), 1.0, Hit(FAR, NO_TRIANGLE, 0.0, 0.0));
    waiting_count = 0u;
    follow(Segment(eye.origin, 0.0, eye.direction, NO_TRIANGLE, vec3<f32>(1.0), 0u));
}

fn follow(segment: Segment) {
    at_hand = segment;
    asked = query_of(segment);
}

/// Takes the answer to `asked`, and asks what comes next; false when everything has been `seen`.
fn step_path(hit: Hit) -> bool {
    var asks_lights = false;
    if asked.kind == LOOK {
        if hit.triangle == NO_TRIANGLE {
            leave();
        } else {
            view(hit);
            let is_first = (at_hand.depth_layers & 255u) == 0u && seen.first.triangle == NO_TRIANGLE && view_alpha > 0.0;
            if is_first { seen.first = hit; }
            asks_lights = true;
        }
    } else {
        asks_lights = take_share(hit);
    }
    if only_first && (seen.first.triangle != NO_TRIANGLE || hit.triangle == NO_TRIANGLE) { return false; }

    // Ask the next light that would be seen, and when all have been asked go on behind the surface.
    if asks_lights {
        if !only_first && ask_light() { return true; }
        seen.color += times3(covered, local_sum);
        put_off();
    } else if asked.kind != LOOK {
        return true;
    }

    // Take up the ray that was put off last.
    if waiting_count == 0u { return false; }
    follow(pop_segment());
    return true;
}

/// The ray meets nothing: it sees what lies behind everything.
fn leave() {
    seen.color += times3(at_hand.weight, radiance(at_hand.direction));
    if (at_hand.depth_layers & 255u) == 0u && backdrop_is_none() {
        seen.alpha = 1.0 - max_element(at_hand.weight);
    }
}

/// The ray meets a surface: what it sees there, before any light is asked.
fn view(hit: Hit) {
    let paint = paint_at(hit);
    view_hit = hit;
    view_surface = surface_at(hit, at_hand.direction);
    view_terms = terms_of(paint, view_surface, at_hand.direction);
    view_alpha = paint.alpha;
    covered = scaled(at_hand.weight, paint.alpha);
    local_sum = view_terms.emissive + times3(view_terms.ambient, scene.ambient);
    let is_lit = any(covered != vec3<f32>(0.0)) && (any(view_terms.diffuse != vec3<f32>(0.0)) || view_terms.f90 != 0.0);
    next_light = select(scene.light_count, 0u, is_lit);
}

/// 2^-64: what a light sends back below it is nothing (shade.rs).
const LEAST_SENT: f32 = 5.42101086e-20;

/// Finds the next light that sends something back if nothing is in its way, and asks for its shadow; false when there is none
/// left. Without shadows all of them are added up.
fn ask_light() -> bool {
    let origin = offset_origin(view_surface, view_surface.facing);
    loop {
        if next_light >= scene.light_count { return false; }
        let light = incoming(light_at(next_light), origin);
        next_light += 1u;

        // The light must shine on the viewer's side of both normals.
        let cosine = dot3(light.direction, view_surface.shading);
        if !light.arrives || cosine <= 0.0 || dot3(light.direction, view_surface.facing) <= 0.0 { continue; }

        // Ask for its shadow only if it would be seen.
        let share = reflected(view_terms, view_surface, light.direction, at_hand.direction);
        sent_back = times3(light.irradiance, scaled(share, cosine));
        if max_element(sent_back) < LEAST_SENT { continue; }
        if !has_feature(FEATURE_SHADOWS) {
            local_sum += sent_back;
            continue;
        }
        counts.y += 1u;
        passed = vec3<f32>(1.0);
        layers_passed = 0u;
        asked = Query(Ray(origin, clearance(view_surface), light.direction, light.reach), 0.0, NO_TRIANGLE, OPAQUE);
        return true;
    }
    return false;
}

/// Takes the answer of a shadow ray. True when the light's share is known and added; else the next layer is asked for.
fn take_share(hit: Hit) -> bool {
    let is_hit = hit.triangle != NO_TRIANGLE;
    if asked.kind == OPAQUE {
        // Nothing opaque is in the way: in most scenes the whole question.
        if is_hit { return true; }
        if !SEES_THROUGH {
            local_sum += sent_back;
            return true;
        }
        asked.kind = LAYER;
        return false;
    }
    if !is_hit {
        local_sum += times3(sent_back, passed);
        return true;
    }

    // Filter the light surface by surface, each once. Behind as many layers as a path may pass there is none.
    let paint = paint_at(hit);
    let through = scaled(paint.base, times(glass_share(paint), paint.alpha));
    passed = times3(passed, through + vec3<f32>(1.0 - paint.alpha));
    layers_passed += 1u;
    if is_cut_off(passed) || layers_passed >= MAX_LAYERS { return true; }
    asked.after_t = hit.t;
    asked.after_triangle = hit.triangle;
    asked.ray.t_min = below(hit.t);
    return false;
}

/// Puts off the rays behind the surface that the ray at hand has met.
fn put_off() {
    let direction = at_hand.direction;
    let depth = at_hand.depth_layers & 255u;
    let layers = at_hand.depth_layers >> 8u;

    // Go straight on past the uncovered part and through unbent glass.
    if SEES_THROUGH {
        var straight = scaled(at_hand.weight, 1.0 - view_alpha);
        if !view_terms.is_bent { straight += times3(covered, view_terms.passed); }
        if layers < MAX_LAYERS {
            let after_t = view_hit.t;
            let more = push_segment(
                Segment(at_hand.origin, after_t, direction, view_hit.triangle, straight, at_hand.depth_layers + 256u),
            );
            if !only_first { counts.w += more; }
        }
    }
    if depth >= frame.max_depth || only_first { return; }

    // Go through bent glass.
    let after_t = clearance(view_surface);
    let deeper = at_hand.depth_layers + 1u;
    if HAS_GLASS && view_terms.is_bent {
        let origin = offset_origin(view_surface, -view_surface.facing);
        let weight = times3(covered, view_terms.passed);
        counts.w += push_segment(Segment(origin, after_t, view_terms.bent, NO_TRIANGLE, weight, deeper));
    }

    // Follow the mirror.
    if (HAS_MIRRORS || HAS_GLASS) && any(view_terms.mirror != vec3<f32>(0.0)) {
        let origin = offset_origin(view_surface, view_surface.facing);
        let mirrored = reflect_at(direction, view_surface);
        let weight = times3(covered, view_terms.mirror);
        counts.z += push_segment(Segment(origin, after_t, mirrored, NO_TRIANGLE, weight, deeper));
    }
}
