//! Keeps the table of the objects that C has handles of, the only global state. A handle is a number, never an address.
//! Using one that was dropped, was never created, or belongs to an object of another kind is an error.
//!
//! The crate slotmap would reuse a handle after 2^31 objects in one entry, which takes 2.5 days at 10,000 messages per second;
//! here such an entry is retired.
use std::{
    any::Any,
    mem::MaybeUninit,
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard,
    },
};

use crate::{
    boundary::{call, ErrorOut},
    failure::{Code, Failure},
};

/// An object that C may have a handle of.
pub trait Object: Any + Send + Sync {
    /// The kind of the object, for error texts.
    const KIND: &'static str;

    /// Called when the handle is dropped. Must end waiting calls; when it returns, no callback of the object may run any
    /// more. Calls in progress still hold the object.
    fn on_dropped(&self) {}
}

type Shared = Arc<dyn Any + Send + Sync>;
/// Calls [`Object::on_dropped`] of the concrete type.
type OnDropped = fn(&Shared);

struct Entry {
    /// How many objects have occupied this entry. It is the upper half of a handle.
    generation: u32,
    object: Option<(Shared, OnDropped)>,
}

#[derive(Default)]
struct Table {
    entries: Vec<Entry>,
    free: Vec<u32>,
}

static TABLE: RwLock<Table> = RwLock::new(Table {
    entries: Vec::new(),
    free: Vec::new(),
});

/// Keeps the object until its handle is dropped. Returns the handle, which is never 0.
pub fn insert<T: Object>(object: T) -> u64 {
    insert_shared(Arc::new(object))
}

/// The same as [`insert`], for an object that is already shared.
pub fn insert_shared<T: Object>(object: Arc<T>) -> u64 {
    let on_dropped = |object: &Shared| {
        if let Some(object) = object.downcast_ref::<T>() {
            object.on_dropped();
        }
    };
    let mut table = write();
    let index = table.free.pop().unwrap_or_else(|| {
        table.entries.push(Entry {
            generation: 0,
            object: None,
        });
        // Does not fail in practice, because 4 billion entries do not fit into memory.
        u32::try_from(table.entries.len() - 1).expect("less than 4 billion objects")
    });
    let entry = &mut table.entries[index as usize];
    entry.generation += 1;
    entry.object = Some((object, on_dropped));
    u64::from(entry.generation) << 32 | u64::from(index)
}

/// Returns the object behind a handle.
pub fn get<T: Object>(handle: u64) -> Result<Arc<T>, Failure> {
    let table = read();
    let entry = table.entries.get(handle as u32 as usize);
    let object = entry
        .filter(|entry| u64::from(entry.generation) == handle >> 32)
        .and_then(|entry| entry.object.as_ref());
    let object = object.and_then(|(object, _)| object.clone().downcast().ok());
    object.ok_or_else(|| Failure::Handle(T::KIND))
}

/// Drops the object behind a handle.
pub fn remove(handle: u64) -> Result<(), Failure> {
    let (object, on_dropped) = {
        let mut table = write();
        let entry = table.entries.get_mut(handle as u32 as usize);
        let entry = entry.filter(|entry| u64::from(entry.generation) == handle >> 32);
        let (generation, object) = entry
            .and_then(|entry| Some((entry.generation, entry.object.take()?)))
            .ok_or(Failure::Handle("any object"))?;
        // An entry whose generations are used up is not reused.
        if generation < u32::MAX {
            table.free.push(handle as u32);
        }
        object
    };
    // The table is unlocked here: callbacks that end now may use it.
    on_dropped(&object);
    Ok(())
}

fn count() -> usize {
    let table = read();
    let occupied = table.entries.iter().filter(|entry| entry.object.is_some());
    occupied.count()
}

/// Locks a part of an object, also after a panic of a thread that had locked it.
pub fn lock<T>(part: &Mutex<T>) -> MutexGuard<'_, T> {
    part.lock().unwrap_or_else(PoisonError::into_inner)
}

fn read() -> RwLockReadGuard<'static, Table> {
    TABLE.read().unwrap_or_else(PoisonError::into_inner)
}

fn write() -> RwLockWriteGuard<'static, Table> {
    TABLE.write().unwrap_or_else(PoisonError::into_inner)
}

/// Drops the object of any kind that an `id` belongs to, and sets the `id` to 0. An `id` of 0 is ignored, like `free(NULL)`.
///
/// When this returns, no callback of the object runs any more, except the one that calls this function. Two threads may drop
/// the same variable at the same time; one of them does it.
///
/// Returns `RECT_CODE_HANDLE` if the object was already dropped through a copy of the `id`; nothing else happens then. May
/// be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_drop(
    id: *mut u64,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        if id.is_null() || !id.cast::<AtomicU64>().is_aligned() {
            return Err(Failure::argument(
                "id",
                "is NULL or is not the address of an id",
            ));
        }
        // SAFETY: `id` is aligned, points to an id as rect.h requires, and other threads access it only through this
        // function.
        let id = unsafe { AtomicU64::from_ptr(id) };
        match id.swap(0, Ordering::AcqRel) {
            0 => Ok(()),
            handle => remove(handle),
        }
    })
}

/// Returns the number of handles that exist now. If it is the same at the beginning and at the end of a test, the test has
/// dropped everything.
///
/// May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_handle_count() -> usize {
    count()
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
    fn dropped_handle_stays_invalid_after_its_entry_is_reused() {
        let dropped = Arc::new(AtomicUsize::new(0));
        let first = insert(One(dropped.clone()));
        assert!(get::<One>(first).is_ok());
        assert!(
            get::<Other>(first).is_err(),
            "the handle belongs to another kind"
        );
        remove(first).expect("a valid handle");
        assert_eq!(dropped.load(Ordering::SeqCst), 1);
        let all: Vec<u64> = (0..100).map(|_| insert(Other)).collect();
        assert!(get::<One>(first).is_err() && remove(first).is_err());
        assert!(all.iter().all(|&other| get::<Other>(other).is_ok()));
        assert!(count() >= 100);
        all.iter()
            .for_each(|&other| remove(other).expect("a valid handle"));
        assert_eq!(dropped.load(Ordering::SeqCst), 1);
        for invented in [0, 1, u64::MAX, 1 << 32 | 0xffff_ffff] {
            assert!(remove(invented).is_err(), "{invented}");
        }
    }

    #[test]
    fn exactly_one_of_several_threads_drops_a_handle() {
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
            // SAFETY: the pointer is that of a local variable.
            assert_eq!(unsafe { rect_drop(&mut copy, None) }, Code::Handle);
            // SAFETY: the pointer is that of a local variable.
            assert_eq!((copy, unsafe { rect_drop(&mut copy, None) }), (0, Code::Ok));
        }
        assert_eq!(dropped.load(Ordering::SeqCst), 100);
        // SAFETY: NULL is permitted.
        let code = unsafe { rect_drop(std::ptr::null_mut(), None) };
        assert_eq!(code, Code::Argument);
    }
}
