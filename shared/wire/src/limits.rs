//! Everything that has a bound, with the reason for it. A peer that exceeds one is cut off, never obeyed.

use std::time::Duration;

/// Encoded bytes of the first message of a peer, and decoded bytes of its lists and texts. It carries a name and a handful of numbers;
/// nobody is trusted with more before `Welcome`.
pub const HELLO_BYTES: usize = 4 << 10;

/// Encoded bytes of any other control message, and decoded bytes of its lists. The largest is an `Assign` of
/// [`TILES`] tiles: 65,536 x 4 bytes decoded.
pub const CONTROL_BYTES: usize = 512 << 10;

/// Encoded and decoded bytes of a header on a bulk pipe. The largest announces [`TILES`] tiles of 72 bytes
/// each in memory.
pub const HEADER_BYTES: usize = 8 << 20;

/// Frames that a worker has begun and not been told the end of: two for each of a pipeline's stages, and as many that are given up.
pub const FRAMES: usize = 8;

/// Encoded bytes of a [`crate::PackChunk`]: a hash and two numbers of at most 9 bytes each.
pub const CHUNK_HEADER_BYTES: usize = 64;

/// Characters of a worker's name and of a reason, in bytes.
pub const TEXT_BYTES: usize = 512;

/// Versions that a peer may offer.
pub const VERSIONS: usize = 16;

/// Columns or rows of an image: the range in which pixel coordinates + 0.5 are exact in `f32` with room to
/// spare.
pub const SIDE: u32 = 1 << 16;

/// Pixels of an image, 16,384 x 16,384: below 2^32 bytes in every format but the layers, 9 GiB in those.
pub const PIXELS: u64 = 1 << 28;

/// Tiles of a frame. A tile costs a message's worth of overhead; a grid beyond this wants larger tiles.
pub const TILES: u32 = 1 << 16;

/// Bytes of one tile's pixels, 1,365 x 1,365 pixels of layers: what one side must hold in one piece. Larger
/// tiles are refused.
pub const TILE_BYTES: u64 = 64 << 20;

/// Samples a pixel.
pub const SAMPLES: u32 = 1 << 16;

/// Reflections and refractions a path may take: the tracer's path stack.
pub const DEPTH: u32 = 32;

/// Surfaces that a path passes straight, besides.
pub const LAYERS: u32 = 64;

/// Rays behind one sample that look for a surface; each surface asks for every light. Cut-off and depth of a frame bound them together, far
/// above what a picture needs: 19 million with the least cut-off ([`crate::Sampling::BOUNDING_CUTOFF`]) at depth 32, 112,000 by default.
pub const RAYS: u64 = 1 << 25;

/// Bytes of a pack: far above the largest scene (San Miguel is 0.5 GiB), far below what makes arithmetic
/// wrap.
pub const PACK_BYTES: u64 = 1 << 40;

/// Raw bytes behind one [`crate::PackChunk`]: small enough that an abort is prompt, large enough that headers
/// cost nothing.
pub const CHUNK_BYTES: u32 = 1 << 20;

/// Batches that a worker may have rendered and not yet handed to the transport: one travels while the next is
/// filled.
pub const BATCHES_IN_FLIGHT: usize = 2;

/// How long a connection may be silent before the peer counts as lost. [`KEEP_ALIVE`] keeps a healthy one
/// from being silent.
pub const IDLE_TIMEOUT: Duration = Duration::from_secs(5);

/// How often a quiet connection is pinged: four may be lost before [`IDLE_TIMEOUT`].
pub const KEEP_ALIVE: Duration = Duration::from_secs(1);

/// Unread bytes that one stream may have under way: 1 Gbit/s over 64 ms.
pub const STREAM_WINDOW_BYTES: u32 = 8 << 20;

/// Unread bytes that all streams of a connection may have under way, in each direction.
pub const CONNECTION_WINDOW_BYTES: u32 = 16 << 20;

/// The same for a peer that has not shown a valid token yet: its `Hello`, and the first bytes of its bulk pipe.
pub const STRANGER_WINDOW_BYTES: u32 = 16 << 10;

/// Connections in the making, from the first packet to `Hello`, that a master has at a time. When one more comes, the oldest goes: an
/// honest joiner needs two round trips, so that only who is silent becomes old.
pub const STRANGERS: usize = 64;

/// From so many on, who comes must first show that its address is its own (QUIC's `Retry`), which costs the master no memory.
pub const STRANGERS_UNPROVEN: usize = 8;

/// First packets that wait for the master to look at them; more are refused.
pub const INCOMING: usize = 64;

/// Workers that a master takes, all of them in each frame's report.
pub const WORKERS: usize = 1024;

/// Numeric classes of one frame that are told of: a fleet has a handful of devices and drivers.
pub const CLASSES: usize = 16;

/// Clients that a master takes, and so frames that wait at it.
pub const CLIENTS: usize = 32;

/// How long a client may neither take nor give a byte in the middle of a transfer.
pub const CLIENT_TIMEOUT: Duration = Duration::from_secs(60);

/// How long a client may ask for nothing: who looks at a frame before the next is asked for has not gone, and those who wait want
/// its seat and its pack's room.
pub const CLIENT_IDLE: Duration = Duration::from_secs(600);

/// Wanted kernel buffers of a UDP socket: 32 ms at 1 Gbit/s, so that a busy receiver does not lose packets.
pub const SOCKET_BUFFER_BYTES: usize = 4 << 20;

/// Largest UDP payload that is taken, and that path discovery tries: Ethernet's jumbo frames less the IP and
/// UDP headers. Loopback carries it as well; elsewhere discovery stops at what the path carries.
pub const UDP_PAYLOAD_BYTES: u16 = 9000 - 28;

/// How long either side waits for `Hello`, `Welcome` or `Refuse` on a new connection.
pub const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);

/// How long the master waits for the next tile of a worker that has nothing left to render: a minute for a
/// busy machine, and a second a MiB of the largest tile, as for packs.
pub const RETURN_TIMEOUT: Duration = Duration::from_secs(60 + (TILE_BYTES >> 20));

/// How long the master waits for `PackReady` of a pack of `bytes`: a minute for validation, and a second a
/// MiB for the slowest link that is still worth using (8 Mbit/s).
pub const fn pack_timeout(bytes: u64) -> Duration {
    Duration::from_secs(60 + (bytes >> 20))
}
