// A stack of its own for every ray, as deep as a tree may be: the oracle of stack_short.wgsl.

var<private> waiting_at: array<u32, MAX_DEPTH>;
var<private> waiting_t0: array<f32, MAX_DEPTH>;
var<private> waiting_t1: array<f32, MAX_DEPTH>;
var<private> waiting: u32;

fn stack_clear() {
    waiting = 0u;
}

/// Goes on in the near cell, the far one or both, one after the other.
fn stack_split(near: u32, far: u32, only_near: bool, only_far: bool, near_t1: f32, far_t0: f32) {
    if !only_near && !only_far {
        waiting_at[waiting] = far;
        waiting_t0[waiting] = far_t0;
        waiting_t1[waiting] = cell_t1;
        waiting += 1u;
        cell_t1 = near_t1;
    }
    cell_at = select(near, far, only_far);
}

/// Takes up the nearest cell that waits and does not lie behind the best hit; false when there is none.
fn stack_pop(best_t: f32) -> bool {
    loop {
        if waiting == 0u { return false; }
        waiting -= 1u;
        cell_at = waiting_at[waiting];
        cell_t0 = waiting_t0[waiting];
        cell_t1 = waiting_t1[waiting];
        if !(best_t < cell_t0 * (1.0 - MARGIN)) { return true; }
    }
    return false;
}
