//! Typed device buffers.

use std::marker::PhantomData;
use std::sync::mpsc;

use bytemuck::{AnyBitPattern, NoUninit};

use super::device::{Device, Held};
use super::error::Error;

/// A device buffer of `len` values of `T`.
#[derive(Debug)]
pub(super) struct Buffer<T> {
    pub(super) raw: wgpu::Buffer,
    label: &'static str,
    len: usize,
    usage: wgpu::BufferUsages,
    _held: Held,
    element: PhantomData<T>,
}

impl<T: NoUninit + AnyBitPattern> Buffer<T> {
    /// A buffer holding a copy of `values`; an empty slice becomes one zero value, as bindings cannot be empty.
    ///
    /// # Errors
    /// [`Error::TooLarge`] beyond the adapter's binding size, [`Error::OutOfMemory`] where the device is full.
    pub(super) fn from_slice(
        device: &Device,
        label: &'static str,
        values: &[T],
        usage: wgpu::BufferUsages,
    ) -> Result<Self, Error> {
        let buffer = Self::zeroed(device, label, values.len().max(1), usage)?;
        device
            .queue
            .write_buffer(&buffer.raw, 0, bytemuck::cast_slice(values));
        Ok(buffer)
    }

    /// A buffer of `len` zero values.
    ///
    /// # Errors
    /// As [`Self::from_slice`].
    pub(super) fn zeroed(
        device: &Device,
        label: &'static str,
        len: usize,
        usage: wgpu::BufferUsages,
    ) -> Result<Self, Error> {
        let bytes = len as u64 * size_of::<T>() as u64;
        let available_bytes = device.max_binding_bytes();
        if bytes > available_bytes {
            return Err(Error::TooLarge {
                what: label,
                needed_bytes: bytes,
                available_bytes,
            });
        }
        let descriptor = wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT),
            usage: usage | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        };
        let raw = device
            .checked(label, || device.device.create_buffer(&descriptor))
            .map_err(|error| match error {
                Error::OutOfMemory {
                    stage, held_bytes, ..
                } => Error::OutOfMemory {
                    stage,
                    needed_bytes: bytes,
                    held_bytes,
                },
                other => other,
            })?;
        Ok(Self {
            raw,
            label,
            len,
            usage,
            _held: device.hold(descriptor.size),
            element: PhantomData,
        })
    }

    /// Values it holds.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Makes room for `len` values. Their old values are lost if there was not enough.
    ///
    /// # Errors
    /// As [`Self::from_slice`].
    pub(super) fn grow(&mut self, device: &Device, len: usize) -> Result<(), Error> {
        if len <= self.len {
            return Ok(());
        }
        let available_bytes = device.max_binding_bytes();
        let most = (available_bytes / size_of::<T>() as u64) as usize;
        if len > most {
            return Err(Error::TooLarge {
                what: self.label,
                needed_bytes: (len * size_of::<T>()) as u64,
                available_bytes,
            });
        }
        // The old buffer goes first, so that both need not fit; without a new one it holds nothing.
        self.raw.destroy();
        self.len = 0;
        self._held = device.hold(0);
        let wanted = len.next_power_of_two().min(most);
        *self = Self::zeroed(device, self.label, wanted, self.usage)?;
        Ok(())
    }

    /// Size on the device.
    pub(super) fn bytes(&self) -> u64 {
        self.raw.size()
    }

    /// Overwrites the first `values.len()` values.
    pub(super) fn write(&self, device: &Device, values: &[T]) {
        assert!(
            values.len() <= self.len,
            "{}: {} values into a buffer of {}",
            self.label,
            values.len(),
            self.len
        );
        device
            .queue
            .write_buffer(&self.raw, 0, bytemuck::cast_slice(values));
    }

    /// Overwrites the values from `at` on.
    pub(super) fn write_at(&self, device: &Device, at: usize, values: &[T]) {
        assert!(
            at + values.len() <= self.len,
            "{}: {} values at {at} of {}",
            self.label,
            values.len(),
            self.len
        );
        let offset = (at * size_of::<T>()) as u64;
        device
            .queue
            .write_buffer(&self.raw, offset, bytemuck::cast_slice(values));
    }

    /// Copies the first `len` values back to the host; waits for the device.
    ///
    /// # Errors
    /// [`Error::Lost`] and what else the driver says.
    pub(super) fn read(&self, device: &Device, len: usize) -> Result<Vec<T>, Error> {
        self.read_at(device, 0, len)
    }

    /// [`Self::read`] of the values from `at` on.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub(super) fn read_at(&self, device: &Device, at: usize, len: usize) -> Result<Vec<T>, Error> {
        assert!(
            at + len <= self.len,
            "{}: reading {len} values at {at} of {}",
            self.label,
            self.len
        );
        if len == 0 {
            return Ok(Vec::new());
        }
        let bytes = (len * size_of::<T>()) as u64;
        let offset = (at * size_of::<T>()) as u64;
        let staging = device.checked(self.label, || {
            let staging = device.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size: bytes,
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            let mut encoder =
                device
                    .device
                    .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                        label: Some("readback"),
                    });
            encoder.copy_buffer_to_buffer(&self.raw, offset, &staging, 0, bytes);
            device.queue.submit([encoder.finish()]);
            staging
        })?;
        let (mapped, is_mapped) = mpsc::sync_channel(1);
        staging.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver waits below, so a full or closed channel cannot happen.
            let _ = mapped.try_send(result);
        });
        device.wait()?;
        let rejected = |reason: String| Error::Rejected {
            stage: self.label,
            reason,
        };
        is_mapped
            .recv()
            .map_err(|e| rejected(e.to_string()))?
            .map_err(|e| rejected(e.to_string()))?;
        let view = staging
            .get_mapped_range(..)
            .map_err(|e| rejected(e.to_string()))?;
        Ok(bytemuck::pod_collect_to_vec(&view))
    }
}
