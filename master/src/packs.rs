//! Memory that clients may fill: packs that they have sent, kept by hash, checked, and what is promised to packs and images.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};
use tessera_pack::Pack;
use tessera_wire::{PackId, PackRefusal, limits};

/// Packs in memory, and room that is promised, within a limit. A pack that a client or its frame holds stays; the others go, the
/// oldest first, when their room is needed. Only the pack of the last frame, which the cluster holds for workers that join late, may
/// outlive its place here.
pub(crate) struct PackStore {
    bytes_max: u64,
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    /// The one that was asked for last is the last.
    packs: VecDeque<Arc<Kept>>,
    /// By packs, here or still held, and by what is promised; at most `bytes_max`.
    taken: u64,
}

/// A pack in its room.
pub(crate) struct Kept {
    pub(crate) pack: Pack,
    room: Room,
}

/// Room for a pack or an image; given back when dropped.
pub(crate) struct Room {
    store: Arc<PackStore>,
    length: u64,
}

impl PackStore {
    /// Nothing, with room for `bytes_max`.
    pub(crate) fn new(bytes_max: u64) -> Arc<Self> {
        Arc::new(Self { bytes_max, inner: Mutex::default() })
    }

    /// The pack, if it is here.
    pub(crate) fn get(&self, id: PackId) -> Option<Arc<Kept>> {
        let mut inner = self.inner();
        let at = inner.packs.iter().position(|kept| kept.pack.id().0 == id.0)?;
        let kept = inner.packs.remove(at)?;
        inner.packs.push_back(kept.clone());
        Some(kept)
    }

    /// Room for `length` bytes; packs that nobody holds go for it, if that is enough.
    pub(crate) fn make_room(self: &Arc<Self>, length: u64) -> Result<Room, PackRefusal> {
        // Let go after `inner`: giving room back asks for it.
        let mut gone = Vec::new();
        let mut inner = self.inner();
        let idle: u64 = inner.packs.iter().filter(|kept| is_idle(kept)).map(|kept| kept.room.length).sum();
        let has = (self.bytes_max - inner.taken + idle).min(limits::PACK_BYTES);
        if length > has {
            return Err(PackRefusal::OutOfMemory { needs: length, has });
        }
        while self.bytes_max - inner.taken < length {
            let Some(at) = inner.packs.iter().position(is_idle) else { break };
            let Some(mut kept) = inner.packs.remove(at).and_then(Arc::into_inner) else { break };
            inner.taken -= std::mem::take(&mut kept.room.length);
            gone.push(kept);
        }
        inner.taken += length;
        Ok(Room { store: self.clone(), length })
    }

    /// Puts a pack into its room; the one that is here already, if it came twice.
    pub(crate) fn keep(&self, room: Room, pack: Pack) -> Arc<Kept> {
        let new = Arc::new(Kept { pack, room });
        let mut inner = self.inner();
        if let Some(known) = inner.packs.iter().find(|known| known.pack.id() == new.pack.id()) {
            return known.clone();
        }
        inner.packs.push_back(new.clone());
        new
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether nobody but the store holds it. Under the store's lock it stays so: others get it from there alone.
fn is_idle(kept: &Arc<Kept>) -> bool {
    Arc::strong_count(kept) == 1
}

impl Drop for Room {
    fn drop(&mut self) {
        self.store.inner().taken -= self.length;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_pack::{Material, PackInput, PackOptions, build_pack};

    /// Packs of equal length and different content.
    fn pack(number: u32) -> Pack {
        let input = PackInput {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, f64::from(number + 1), 0.0]],
            triangles: vec![[0, 1, 2]],
            material_runs: vec![(0, 0)],
            materials: vec![Material::default()],
            ..PackInput::default()
        };
        build_pack(input, &PackOptions::default()).unwrap().0
    }

    fn put(store: &Arc<PackStore>, pack: &Pack) {
        let room = store.make_room(pack.bytes().len() as u64).unwrap();
        store.keep(room, pack.clone());
    }

    #[test]
    fn the_pack_that_was_asked_for_longest_ago_goes_first() {
        let packs: Vec<_> = (0..4).map(pack).collect();
        let length = packs[0].bytes().len() as u64;
        let id = |at: usize| PackId(packs[at].id().0);
        let store = PackStore::new(3 * length);
        packs[..3].iter().for_each(|pack| put(&store, pack));
        assert!(store.get(id(0)).is_some());
        put(&store, &packs[3]);
        let held = (0..4).map(|at| store.get(id(at)).is_some()).collect::<Vec<_>>();
        assert_eq!(held, [true, false, true, true]);
        put(&store, &packs[3]);
        let copies = store.inner().packs.iter().filter(|kept| kept.pack.id() == packs[3].id()).count();
        assert_eq!(copies, 1, "twice is once");
    }

    #[test]
    fn what_is_promised_and_what_is_held_stay_within_the_limit() {
        let pack = pack(0);
        let length = pack.bytes().len() as u64;
        let store = PackStore::new(2 * length);
        put(&store, &pack);
        let first = store.make_room(length).unwrap();
        let second = store.make_room(length).unwrap();
        assert_eq!(store.inner().packs.len(), 0, "it went for what is on its way");
        let refused = PackRefusal::OutOfMemory { needs: 1, has: 0 };
        assert_eq!(store.make_room(1).err(), Some(refused));
        drop(second);
        store.keep(first, pack.clone());
        let refused = PackRefusal::OutOfMemory { needs: 2 * length + 1, has: 2 * length };
        assert_eq!(store.make_room(2 * length + 1).err(), Some(refused));
        assert_eq!(store.inner().packs.len(), 1, "a refusal costs nobody his place");
        assert!(store.make_room(u64::MAX).is_err());
    }

    #[test]
    fn a_pack_that_somebody_holds_keeps_its_room() {
        let packs = [pack(0), pack(1)];
        let length = packs[0].bytes().len() as u64;
        let store = PackStore::new(2 * length);
        let room = store.make_room(length).unwrap();
        let held = store.keep(room, packs[0].clone());
        put(&store, &packs[1]);
        let refused = PackRefusal::OutOfMemory { needs: length + 1, has: length };
        assert_eq!(store.make_room(length + 1).err(), Some(refused));
        let room = store.make_room(length).unwrap();
        assert!(store.get(PackId(packs[0].id().0)).is_some(), "the other went");
        assert_eq!(store.make_room(1).err(), Some(PackRefusal::OutOfMemory { needs: 1, has: 0 }));
        drop((held, room));
        drop(store.make_room(2 * length).unwrap());
        let inner = store.inner();
        assert_eq!((inner.taken, inner.packs.len()), (0, 0));
    }
}
