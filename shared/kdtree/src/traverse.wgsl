// Sibling of traverse.rs, in the order of a machine whose neighbouring rays take their steps together: walk until a triangle may be
// crossed, then locate the crossing, for all rays of a group at once; what the walk must remember of the way is in stack_*.wgsl. The answer
// does not depend on that order: no cell decides about a hit.
//
// `slot_at`, `list_at`, `corners_of` are pack's; `accepts` is whitted's.

/// What is looked for along a ray.
struct Query {
    ray: Ray,
    /// Hits count that come after (after_t, after_triangle); NO_TRIANGLE when `ray.t_min` says all.
    after_t: f32,
    after_triangle: u32,
    /// LOOK, OPAQUE or LAYER: see `accepts`.
    kind: u32,
}

/// Half the thickness of the ray, in units of the largest coordinate of the scene relative to its origin: LATERAL_ERROR, one roundoff of
/// `t`, and a plane distance with its slack: gamma(10), the inverse being off by up to five roundoffs.
const THICKNESS: f32 = 1.4901173e-6;

/// 1 -+ 2 gamma(7), as in aabb.rs with such an inverse.
const SHORTEN: f32 = 0.99999917;
const LENGTHEN: f32 = 1.0000008;

/// A ray as the traversal sees it.
var<private> line_origin: vec3<f32>;
/// `1 / direction`; 0 for a ray that is parallel to planes across this axis.
var<private> line_inverse: vec3<f32>;
var<private> line_slack: vec3<f32>;
var<private> line_radius: f32;

/// The cell at hand: its node and its interval.
var<private> cell_at: u32;
var<private> cell_t0: f32;
var<private> cell_t1: f32;

/// The part of the ray inside the scene's box, as thick as it counts; false when there is none.
fn enter_line(ray: Ray) -> bool {
    line_origin = ray.origin;
    let d = divisor(ray.direction);
    let is_parallel = d == vec3<f32>(0.0);
    line_inverse = select(quotient3(vec3<f32>(1.0), select(d, vec3<f32>(1.0), is_parallel)), vec3<f32>(0.0), is_parallel);
    let low = scene.root_min - ray.origin;
    let high = scene.root_max - ray.origin;
    line_radius = THICKNESS * max_element(max(abs(low), abs(high)));
    line_slack = line_radius * abs(line_inverse);

    // Cut the ray to the slabs; a parallel one is in a slab or not.
    let a = (low - line_radius) * line_inverse;
    let b = (high + line_radius) * line_inverse;
    let near = select(min(a, b) * SHORTEN, vec3<f32>(-FAR), is_parallel);
    let far = select(max(a, b) * LENGTHEN, vec3<f32>(FAR), is_parallel);
    let is_beside = is_parallel & ((low > vec3<f32>(line_radius)) | (high < vec3<f32>(-line_radius)));
    cell_t0 = max(ray.t_min, max_element(near));
    cell_t1 = min(ray.t_max, min(min(far.x, far.y), far.z));
    return !any(is_beside) && cell_t0 <= cell_t1;
}

/// The nearest hit that `accepts` takes, of equally near ones the smallest id; or, if ANY is asked, the first that comes along.
fn search(query: Query, stop_at_first: bool) -> Hit {
    var best = Hit(query.ray.t_max, 0u, 0.0, 0.0);
    var found = false;
    let ray = query.ray;
    var is_walking = is_traceable(ray) && enter_line(ray);
    let shear = ray_shear(ray.direction);
    stack_clear();
    cell_at = 0u;

    // Triangles that wait to be tested: `left` of them, the next ones `first` and `second`, or from the list on.
    var left = 0u;
    var first = 0u;
    var second = 0u;
    var is_listed = false;
    // Whether the cell at hand is done with, once they are tested, and whether its references are among those tested.
    var is_over = false;
    var has_refs_tested = false;
    var a = vec3<f32>(0.0);
    var b = vec3<f32>(0.0);
    var c = vec3<f32>(0.0);

    loop {
        // Walk until a triangle may be crossed nearer than the best hit.
        var candidate = NO_TRIANGLE;
        loop {
            if !is_walking { break; }

            // Descend to a cell with triangles, or to one that is done with.
            loop {
                if left > 0u || is_over { break; }
                let node = slot_at(cell_at);
                if node_is_leaf(node) {
                    left = node_count(node);
                    first = node.x;
                    is_listed = left > 1u;
                    is_over = true;
                } else if HAS_REFS && node_refs(node) > 0u && !has_refs_tested {
                    // Test the references early: a hit outside this cell is still a true hit.
                    let refs = slot_at(cell_at + 1u);
                    left = node_refs(node);
                    first = refs.x;
                    second = refs.y;
                    is_listed = false;
                    has_refs_tested = true;
                } else if best.t < cell_t0 * (1.0 - MARGIN) {
                    // Nothing in this cell can be nearer.
                    is_over = true;
                } else {
                    cell_t1 = min(cell_t1, best.t);
                    split_cell(node);
                    has_refs_tested = false;
                }
            }

            // Test them in turn.
            loop {
                if left == 0u { break; }
                var id = first;
                if is_listed {
                    id = list_at(first);
                    first += 1u;
                } else {
                    first = second;
                }
                left -= 1u;
                let corners = corners_of(id);
                if may_cross(ray.origin, shear, corners.a, corners.b, corners.c, ray.t_min, best.t) {
                    candidate = id;
                    a = corners.a;
                    b = corners.b;
                    c = corners.c;
                    break;
                }
            }
            if candidate != NO_TRIANGLE { break; }

            // Take up the nearest cell that waits, unless every one of them lies behind the best hit.
            if is_over {
                is_walking = stack_pop(best.t);
                is_over = false;
                has_refs_tested = false;
            }
        }
        if candidate == NO_TRIANGLE { break; }

        // Find the point that the ray passes.
        let crossing = locate(ray.origin, ray.direction, shear.kz, a, b, c);
        let hit = Hit(crossing.t, candidate, crossing.b1, crossing.b2);
        if hit.t > ray.t_min && precedes(hit.t, hit.triangle, best.t, best.triangle) && accepts(query, hit) {
            best = hit;
            found = true;
            if stop_at_first { break; }
        }
    }
    if !found { best.triangle = NO_TRIANGLE; }
    return best;
}

/// Goes on in the cells of an inner node that the ray passes.
fn split_cell(node: vec2<u32>) {
    let axis = node_axis(node);
    let split = node_split(node);
    let origin = select(select(line_origin.z, line_origin.y, axis == 1u), line_origin.x, axis == 0u);
    let inverse = select(select(line_inverse.z, line_inverse.y, axis == 1u), line_inverse.x, axis == 0u);
    let slack = select(select(line_slack.z, line_slack.y, axis == 1u), line_slack.x, axis == 0u);
    let left = cell_at + select(1u, 2u, node_refs(node) > 0u);
    let right = node_right(node);
    let away = split - origin;

    // Find where the ray comes to the plane and leaves it. Along the ray the cells follow each other as its direction points; a plane
    // behind the origin has negative distances and leaves the cell behind it. A ray that is parallel to the plane is on one side of it, or
    // as thick as it is in it.
    let is_parallel = inverse == 0.0;
    let goes_down = inverse < 0.0;
    let near = select(left, right, goes_down);
    let far = select(right, left, goes_down);
    let to_plane = away * inverse;
    let enter = to_plane - slack;
    let leave = to_plane + slack;
    let is_in_plane = is_parallel && abs(away) <= line_radius;
    let only_far = select(leave < cell_t0 * (1.0 - MARGIN), !is_in_plane && away <= 0.0, is_parallel);
    let only_near = select(enter > cell_t1 * (1.0 + MARGIN), !is_in_plane && away > 0.0, is_parallel) && !only_far;
    let far_t0 = select(max(enter, cell_t0), cell_t0, is_parallel);
    let near_t1 = select(min(leave, cell_t1), cell_t1, is_parallel);
    stack_split(near, far, only_near, only_far, near_t1, far_t0);
}
