// The rays that wait behind a path, in memory of its own: see path.wgsl.

/// PATH_STACK is the greatest number of waiting rays, see variant.rs.
var<private> waiting_segments: array<Segment, PATH_STACK>;

fn keep_segment(i: u32, segment: Segment) {
    waiting_segments[i] = segment;
}

fn kept_segment(i: u32) -> Segment {
    return waiting_segments[i];
}
