//! Asking for memory before it is needed.

/// Starts loading the cache line of `values[at]`, which may lie outside: nothing is read.
#[inline(always)]
pub(crate) fn prefetch<T>(values: &[T], at: usize) {
    let place = values.as_ptr().wrapping_add(at);
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a hint; no address faults.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(place.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = place;
}
