// A short stack (Horn, Sugerman, Houston, Hanrahan 2007) with a restart trail (Laine 2010): the SHORT cells that were put off last are
// remembered; when one is wanted that was forgotten, the walk starts again at the root and follows a trail of one bit a level to it.
//
// Level l of the trail is 1 when nothing waits beside the way at that level: the ray passes one cell only, or it is in the far one; 0 when
// it is in the near cell and the far one waits. The deepest 0 above the cell at hand is the next one to go; taking it sets it and clears
// what is deeper, so the trail only ever counts up and the walk ends. The intervals of our thick rays overlap, so a walk could not start
// again from a distance along the ray, as Horn's does. A hit that came meanwhile may have shortened the ray, so that a far cell is no longer
// passed; then the near one is walked again, which costs time and changes nothing.

const SHORT: u32 = 4u;

var<private> short_at: array<u32, SHORT>;
var<private> short_t0: array<f32, SHORT>;
var<private> short_t1: array<f32, SHORT>;
var<private> short_level: array<u32, SHORT>;
/// How many cells are remembered, and in which place of the ring the next one goes.
var<private> short_kept: u32;
var<private> short_next: u32;
/// The levels of the trail, 0 to 31 and 32 to 63, and the level of the cell at hand.
var<private> trail: vec2<u32>;
var<private> level: u32;
var<private> restart_t0: f32;
var<private> restart_t1: f32;

fn stack_clear() {
    short_kept = 0u;
    short_next = 0u;
    trail = vec2<u32>(0u);
    level = 0u;
    restart_t0 = cell_t0;
    restart_t1 = cell_t1;
}

fn trail_bit(at: u32) -> bool {
    return ((select(trail.y, trail.x, at < 32u) >> (at & 31u)) & 1u) == 1u;
}

fn set_trail_bit(at: u32) {
    let bit = 1u << (at & 31u);
    if at < 32u { trail.x |= bit; } else { trail.y |= bit; }
}

fn stack_split(near: u32, far: u32, only_near: bool, only_far: bool, near_t1: f32, far_t0: f32) {
    let passes_both = !only_near && !only_far;
    let takes_far = only_far || (passes_both && trail_bit(level));
    if passes_both && !takes_far {
        short_at[short_next] = far;
        short_t0[short_next] = far_t0;
        short_t1[short_next] = cell_t1;
        short_level[short_next] = level;
        short_next = (short_next + 1u) % SHORT;
        short_kept = min(short_kept + 1u, SHORT);
        cell_t1 = near_t1;
    }
    if passes_both && takes_far { cell_t0 = far_t0; }
    if !passes_both { set_trail_bit(level); }
    cell_at = select(near, far, takes_far);
    level += 1u;
}

fn stack_pop(best_t: f32) -> bool {
    loop {
        // Find the deepest level above the cell at hand where a far cell waits.
        let low = ~trail.x & select((1u << (level & 31u)) - 1u, 0xffffffffu, level >= 32u);
        let high = select(0u, ~trail.y & select((1u << (level & 31u)) - 1u, 0xffffffffu, level >= 64u), level > 32u);
        if (low | high) == 0u { return false; }
        let next = select(firstLeadingBit(low), 32u + firstLeadingBit(high), high != 0u);

        // Mark it as taken, and forget the trail below it.
        if next < 32u {
            trail = vec2<u32>((trail.x & ((1u << next) - 1u)) | (1u << next), 0u);
        } else {
            let bit = 1u << (next - 32u);
            trail.y = (trail.y & (bit - 1u)) | bit;
        }
        if short_kept == 0u {
            // It was forgotten: start again at the root, along the trail.
            cell_at = 0u;
            cell_t0 = restart_t0;
            cell_t1 = min(restart_t1, best_t);
            level = 0u;
            return true;
        }
        short_next = (short_next + SHORT - 1u) % SHORT;
        short_kept -= 1u;
        cell_at = short_at[short_next];
        cell_t0 = short_t0[short_next];
        cell_t1 = short_t1[short_next];
        level = short_level[short_next] + 1u;
        if !(best_t < cell_t0 * (1.0 - MARGIN)) { return true; }
    }
    return false;
}
