//! Decoders of other crates that give up by panicking on damaged files.

use std::any::Any;
use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Runs a decoder; a panic inside it becomes an error, and nothing is printed. Errors come back in one line. Asserts nothing about memory: the caller checks
/// sizes before anything is allocated from them.
pub(crate) fn contained<T>(decode: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    hush_contained();
    let outer = CONTAINED.replace(true);
    let decoded = panic::catch_unwind(AssertUnwindSafe(decode));
    CONTAINED.set(outer);
    let decoded =
        decoded.unwrap_or_else(|payload| Err(format!("is damaged: {}", reason(&*payload))));
    decoded.map_err(|what| what.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// Makes the hook leave out panics that are contained; all others are printed as before.
fn hush_contained() {
    static HUSHED: Once = Once::new();
    HUSHED.call_once(|| {
        let print = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !CONTAINED.get() {
                print(info);
            }
        }));
    });
}

fn reason(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
    text.unwrap_or("its decoder gave up").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_become_errors() {
        let index = std::hint::black_box(7);
        let error = contained(|| Ok([1, 2, 3][index])).unwrap_err();
        assert!(error.contains("is damaged: index out of bounds"), "{error}");
        assert_eq!(contained(|| Ok(5)), Ok(5));
    }
}
