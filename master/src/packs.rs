//! Packs that clients have sent: kept by hash, checked, within a limit.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};
use tessera_pack::Pack;
use tessera_wire::{PackId, PackRefusal, limits};

/// Packs in memory, and room that is promised to packs on their way. What a frame is rendered from is held by the cluster too, and
/// may so outlive its place here.
pub(crate) struct PackStore {
    bytes_max: u64,
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    /// The one that was asked for last is the last.
    packs: VecDeque<Pack>,
    promised: u64,
}

/// Room for a pack that is on its way; given back when dropped.
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
    pub(crate) fn get(&self, id: PackId) -> Option<Pack> {
        let mut inner = self.inner();
        let at = inner.packs.iter().position(|pack| pack.id().0 == id.0)?;
        let pack = inner.packs.remove(at)?;
        inner.packs.push_back(pack.clone());
        Some(pack)
    }

    /// Room for `length` bytes; packs that nobody has asked for lately go for it.
    pub(crate) fn make_room(self: &Arc<Self>, length: u64) -> Result<Room, PackRefusal> {
        let mut inner = self.inner();
        let has = self.bytes_max.min(limits::PACK_BYTES).saturating_sub(inner.promised);
        if length > has {
            return Err(PackRefusal::OutOfMemory { needs: length, has });
        }
        inner.promised += length;
        self.shrink(&mut inner);
        Ok(Room { store: self.clone(), length })
    }

    /// Puts a pack into its room.
    pub(crate) fn keep(&self, room: Room, pack: Pack) {
        // The room is free for a moment; whoever takes it then pushes older packs out.
        drop(room);
        let mut inner = self.inner();
        if inner.packs.iter().all(|known| known.id() != pack.id()) {
            inner.packs.push_back(pack);
        }
        self.shrink(&mut inner);
    }

    /// Lets the oldest packs go until the rest fits.
    fn shrink(&self, inner: &mut Inner) {
        let bytes = |pack: &Pack| pack.bytes().len() as u64;
        while inner.packs.iter().map(bytes).sum::<u64>() + inner.promised > self.bytes_max {
            if inner.packs.pop_front().is_none() {
                return;
            }
        }
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        self.store.inner().promised -= self.length;
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
        let copies = store.inner().packs.iter().filter(|pack| pack.id() == packs[3].id()).count();
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
}
