//! Owns the table of what C has handles of. A handle is a number, never an address: one that was dropped already, made up,
//! or of something else is an error in every build. It is the only state that is shared by all of a process.
use std::{
    any::Any,
    mem::MaybeUninit,
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard,
    },
};

use crate::{
    boundary::{call, ErrorOut},
    failure::{Code, Failure},
};

/// What C may have a handle of.
pub trait Object: Any + Send + Sync {
    /// What it is called in errors.
    const KIND: &'static str;

    /// It was dropped: whoever waits for it is to end, and no callback runs any more when this returns. Calls that are
    /// under way still have it.
    fn on_dropped(&self) {}
}

type Shared = Arc<dyn Any + Send + Sync>;
/// [`Object::on_dropped`] of what it is.
type OnDropped = fn(&Shared);

struct Slot {
    /// How many have been here.
    generation: u32,
    object: Option<(Shared, OnDropped)>,
}

#[derive(Default)]
struct Table {
    slots: Vec<Slot>,
    free: Vec<u32>,
}

static TABLE: RwLock<Table> = RwLock::new(Table {
    slots: Vec::new(),
    free: Vec::new(),
});

/// Keeps it until it is dropped; its handle, which is never 0.
pub fn insert<T: Object>(object: T) -> u64 {
    insert_shared(Arc::new(object))
}

/// The same with what is shared already.
pub fn insert_shared<T: Object>(object: Arc<T>) -> u64 {
    let on_dropped = |object: &Shared| {
        if let Some(object) = object.downcast_ref::<T>() {
            object.on_dropped();
        }
    };
    let mut table = write();
    let index = table.free.pop().unwrap_or_else(|| {
        table.slots.push(Slot {
            generation: 0,
            object: None,
        });
        // Not reached: each takes far more than a byte of memory.
        u32::try_from(table.slots.len() - 1).expect("less than 4 billion objects")
    });
    let slot = &mut table.slots[index as usize];
    slot.generation += 1;
    slot.object = Some((object, on_dropped));
    u64::from(slot.generation) << 32 | u64::from(index)
}

/// What the handle is of.
pub fn get<T: Object>(handle: u64) -> Result<Arc<T>, Failure> {
    let table = read();
    let slot = table.slots.get(handle as u32 as usize);
    let object = slot
        .filter(|slot| u64::from(slot.generation) == handle >> 32)
        .and_then(|slot| slot.object.as_ref());
    let object = object.and_then(|(object, _)| object.clone().downcast().ok());
    object.ok_or_else(|| Failure::Handle(T::KIND))
}

/// Drops what the handle is of.
pub fn remove(handle: u64) -> Result<(), Failure> {
    let (object, on_dropped) = {
        let mut table = write();
        let slot = table.slots.get_mut(handle as u32 as usize);
        let slot = slot.filter(|slot| u64::from(slot.generation) == handle >> 32);
        let (generation, object) = slot
            .and_then(|slot| Some((slot.generation, slot.object.take()?)))
            .ok_or(Failure::Handle("thing"))?;
        // A slot of which the numbers are used up is not used again.
        if generation < u32::MAX {
            table.free.push(handle as u32);
        }
        object
    };
    // With the table free: callbacks that end meanwhile use it.
    on_dropped(&object);
    Ok(())
}

fn live() -> usize {
    let table = read();
    let there = table.slots.iter().filter(|slot| slot.object.is_some());
    there.count()
}

fn read() -> RwLockReadGuard<'static, Table> {
    TABLE.read().unwrap_or_else(PoisonError::into_inner)
}

fn write() -> RwLockWriteGuard<'static, Table> {
    TABLE.write().unwrap_or_else(PoisonError::into_inner)
}

/// Drops what an `id` is of, whatever that is, and sets it to 0; what is 0 stays so, as `free(NULL)`. No callback of it runs
/// any more when this returns, except the one that calls this. Dropped a second time by a copy of the `id`, it is
/// RECT_CODE_HANDLE, and nothing else happens. Two threads may drop the same variable at the same time: one of them does it.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_drop(
    id: *mut u64,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        if id.is_null() || !id.cast::<AtomicU64>().is_aligned() {
            return Err(Failure::argument("id", "is NULL, or no address of an id"));
        }
        // SAFETY: it is the address of an id, as rect.h asks, and aligned; other threads may use it by this function only.
        let id = unsafe { AtomicU64::from_ptr(id) };
        match id.swap(0, Ordering::AcqRel) {
            0 => Ok(()),
            handle => remove(handle),
        }
    })
}

/// How many things have an `id` now: a test that ends with as many as it began has dropped all that it had.
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_live() -> usize {
    live()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::*;

    struct One(Arc<AtomicUsize>);
    struct Other;

    impl Object for One {
        const KIND: &'static str = "one";
        fn on_dropped(&self) {
            self.0.fetch_add(1, Ordering::SeqCst);
        }
    }

    impl Object for Other {
        const KIND: &'static str = "other";
    }

    #[test]
    fn what_was_dropped_is_not_found_even_when_another_has_its_place() {
        let dropped = Arc::new(AtomicUsize::new(0));
        let first = insert(One(dropped.clone()));
        assert!(get::<One>(first).is_ok());
        assert!(get::<Other>(first).is_err(), "of another kind");
        remove(first).expect("there");
        assert_eq!(dropped.load(Ordering::SeqCst), 1);
        let all: Vec<u64> = (0..100).map(|_| insert(Other)).collect();
        assert!(get::<One>(first).is_err() && remove(first).is_err());
        assert!(all.iter().all(|&other| get::<Other>(other).is_ok()));
        assert!(live() >= 100);
        all.iter().for_each(|&other| remove(other).expect("there"));
        assert_eq!(dropped.load(Ordering::SeqCst), 1);
        for made_up in [0, 1, u64::MAX, 1 << 32 | 0xffff_ffff] {
            assert!(remove(made_up).is_err(), "{made_up}");
        }
    }

    #[test]
    fn of_many_who_drop_the_same_one_does() {
        let dropped = Arc::new(AtomicUsize::new(0));
        for _ in 0..100 {
            let handle = insert(One(dropped.clone()));
            let (mut copy, mut done) = (handle, 0);
            std::thread::scope(|scope| {
                let threads: Vec<_> = (0..4)
                    .map(|_| scope.spawn(move || remove(handle).is_ok()))
                    .collect();
                for thread in threads {
                    done += usize::from(thread.join().expect("no panic"));
                }
            });
            assert_eq!(done, 1);
            // SAFETY: the address of a number.
            assert_eq!(unsafe { rect_drop(&mut copy, None) }, Code::Handle);
            // SAFETY: as before.
            assert_eq!((copy, unsafe { rect_drop(&mut copy, None) }), (0, Code::Ok));
        }
        assert_eq!(dropped.load(Ordering::SeqCst), 100);
        // SAFETY: NULL is allowed.
        let code = unsafe { rect_drop(std::ptr::null_mut(), None) };
        assert_eq!(code, Code::Argument);
    }
}
