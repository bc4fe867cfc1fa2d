// Sibling of vertex.rs: the words of a record.

fn record_offsets(w0: u32) -> vec3<u32> {
    return vec3<u32>(w0 & 1023u, (w0 >> 10u) & 1023u, (w0 >> 20u) & 1023u);
}

fn record_cell(w1: u32) -> u32 { return w1 & 0xffffu; }
fn record_normal(w1: u32) -> u32 { return w1 >> 16u; }
fn record_has_side_uv(w0: u32) -> bool { return (w0 & 0x40000000u) != 0u; }

/// Texture coordinates, each in [0, 2), exact.
fn record_uv(w2: u32) -> vec2<f32> {
    return vec2<f32>(f32(w2 & 0xffffu), f32(w2 >> 16u)) * (1.0 / 32768.0);
}

/// Codes from here on mean that there is no normal.
const NORMAL_ENTRIES: u32 = 65534u;
