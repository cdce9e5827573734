//! Assets on the device, kept while they fit.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError, Weak};
use std::time::Duration;

use super::asset::ResidentAsset;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::residency::{NoRoom, Residency};
use crate::backend::gpu::transfer::Transfer;
use crate::field::Field;

/// How often who waits for somebody else's upload asks whether it is cancelled; a piece of an upload takes about as long.
const PATIENCE: Duration = Duration::from_millis(2);

/// Where a field lies in memory. It is the field's alone as long as a [`Weak`] holds the place.
type Place = usize;

#[derive(Debug)]
pub(super) struct Shelf {
    kept: Mutex<Kept>,
}

#[derive(Debug)]
struct Kept {
    residency: Residency<Place>,
    assets: HashMap<Place, (Weak<Field>, Arc<ResidentAsset>)>,
}

/// An asset in use: it stays on the device.
#[derive(Debug)]
pub(super) struct Pinned<'a> {
    shelf: &'a Shelf,
    place: Place,
    pub(super) asset: Arc<ResidentAsset>,
}

impl Shelf {
    pub(super) fn new(limit_bytes: u64) -> Self {
        Self {
            kept: Mutex::new(Kept {
                residency: Residency::new(limit_bytes),
                assets: HashMap::new(),
            }),
        }
    }

    /// Bytes of all kept assets.
    pub(super) fn bytes(&self) -> u64 {
        self.lock().residency.bytes()
    }

    /// A field on the device; uploads it if it is not there. Uploads go one at a time: the bus is one. `cancelled` is asked between pieces
    /// of an upload, and while another one is waited for.
    ///
    /// # Errors
    /// [`Error::NoRoom`] where it does not fit beside what is in use, and what [`ResidentAsset::upload`] fails with.
    pub(super) fn get(
        &self,
        device: &Device,
        field: &Arc<Field>,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Pinned<'_>, Error> {
        let place = Arc::as_ptr(field) as Place;
        let mut kept = self.lock_unless(cancelled)?;
        kept.drop_dead();
        if !kept.residency.pin(place) {
            kept.upload(Transfer::new(device, cancelled), field, place)?;
        }
        let asset = Arc::clone(&kept.assets[&place].1);
        Ok(Pinned {
            shelf: self,
            place,
            asset,
        })
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.kept
            .lock()
            .unwrap_or_else(|poisoned| self.recovered(poisoned))
    }

    /// [`Self::lock`] by a caller that may be cancelled while somebody else's asset is uploaded.
    fn lock_unless(&self, cancelled: &dyn Fn() -> bool) -> Result<MutexGuard<'_, Kept>, Error> {
        loop {
            match self.kept.try_lock() {
                Ok(kept) => return Ok(kept),
                Err(TryLockError::Poisoned(poisoned)) => return Ok(self.recovered(poisoned)),
                Err(TryLockError::WouldBlock) if cancelled() => return Err(Error::Cancelled),
                Err(TryLockError::WouldBlock) => std::thread::sleep(PATIENCE),
            }
        }
    }

    /// A panic while an asset was uploaded leaves its pin.
    fn recovered<'a>(
        &'a self,
        poisoned: PoisonError<MutexGuard<'a, Kept>>,
    ) -> MutexGuard<'a, Kept> {
        self.kept.clear_poison();
        let mut kept = poisoned.into_inner();
        kept.drop_missing();
        kept
    }
}

impl Kept {
    fn upload(
        &mut self,
        upload: Transfer<'_>,
        field: &Arc<Field>,
        place: Place,
    ) -> Result<(), Error> {
        let bytes = ResidentAsset::bytes_of(field);
        let gone = self.residency.admit(place, bytes);
        let gone = gone.map_err(
            |NoRoom {
                 needed_bytes,
                 available_bytes,
             }| Error::NoRoom {
                needed_bytes,
                available_bytes,
            },
        )?;
        for place in gone {
            self.assets.remove(&place);
        }
        let mut uploaded = ResidentAsset::upload(upload, field);
        if matches!(uploaded, Err(Error::OutOfMemory { .. })) {
            // The card has less than the limit, or others use it: nothing but what is in use stays.
            self.drop_unpinned();
            uploaded = ResidentAsset::upload(upload, field);
        }
        match uploaded {
            Ok(asset) => {
                let asset = (Arc::downgrade(field), Arc::new(asset));
                self.assets.insert(place, asset);
                Ok(())
            }
            Err(error) => {
                self.residency.unpin(place);
                self.residency.remove(place);
                Err(error)
            }
        }
    }

    /// Frees what nobody can ask for any more.
    fn drop_dead(&mut self) {
        let dead = self.assets.iter();
        let dead = dead.filter(|(_, (field, _))| field.strong_count() == 0);
        let dead: Vec<Place> = dead.map(|(place, _)| *place).collect();
        for place in dead {
            if self.residency.remove(place) {
                self.assets.remove(&place);
            }
        }
    }

    /// Forgets entries whose asset was never uploaded.
    fn drop_missing(&mut self) {
        for place in self.residency.keys() {
            if !self.assets.contains_key(&place) {
                self.residency.unpin(place);
                self.residency.remove(place);
            }
        }
    }

    fn drop_unpinned(&mut self) {
        for place in self.residency.remove_unpinned() {
            self.assets.remove(&place);
        }
    }
}

impl Drop for Pinned<'_> {
    fn drop(&mut self) {
        self.shelf.lock().residency.unpin(self.place);
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn who_waits_for_an_upload_can_be_cancelled() {
        let shelf = Shelf::new(100);
        let asked = Cell::new(0);
        let cancelled = || {
            asked.set(asked.get() + 1);
            asked.get() == 3
        };
        let uploading = shelf.lock();
        let waited = shelf.lock_unless(&cancelled).map(|_| ());
        assert_eq!(waited, Err(Error::Cancelled));
        drop(uploading);
        assert!(shelf.lock_unless(&cancelled).is_ok());
        assert_eq!(asked.get(), 3, "who need not wait is not asked");
    }

    #[test]
    fn a_panic_while_an_asset_was_uploaded_leaves_no_pin() {
        let shelf = Shelf::new(100);
        let panicked = std::thread::scope(|scope| {
            let upload = scope.spawn(|| {
                let mut kept = shelf.lock();
                kept.residency.admit(7, 60).expect("it fits");
                panic!("the driver");
            });
            upload.join().is_err()
        });
        assert!(panicked);
        assert_eq!(shelf.bytes(), 0);
        assert_eq!(shelf.lock().residency.admit(8, 100), Ok(Vec::new()));
    }
}
