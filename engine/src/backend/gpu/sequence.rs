//! Several dispatches in one submission.

use super::device::Device;
use super::error::Error;
use super::kernel_times::KernelTimes;
use super::pipeline::{Groups, Pipeline};

enum Command<'a> {
    Dispatch(&'a Pipeline, &'a wgpu::BindGroup, Groups),
    Clear(&'a wgpu::Buffer, u64),
    Copy {
        from: &'a wgpu::Buffer,
        offset: u64,
        to: &'a wgpu::Buffer,
        bytes: u64,
    },
}

/// Commands that run one after the other, each seeing what the ones before it wrote.
pub(super) struct Sequence<'a> {
    device: &'a Device,
    label: &'static str,
    commands: Vec<Command<'a>>,
}

impl<'a> Sequence<'a> {
    pub(super) fn new(device: &'a Device, label: &'static str) -> Self {
        Self {
            device,
            label,
            commands: Vec::new(),
        }
    }

    /// Runs a kernel over `groups` with buffers from [`Pipeline::bind`].
    pub(super) fn run(&mut self, kernel: &'a Pipeline, bound: &'a wgpu::BindGroup, groups: Groups) {
        self.commands.push(Command::Dispatch(kernel, bound, groups));
    }

    /// Sets the first `bytes` to 0.
    pub(super) fn clear(&mut self, buffer: &'a wgpu::Buffer, bytes: u64) {
        self.commands.push(Command::Clear(buffer, bytes));
    }

    /// Copies `bytes` from `offset` on to the start of another buffer.
    pub(super) fn copy(
        &mut self,
        from: &'a wgpu::Buffer,
        offset: u64,
        to: &'a wgpu::Buffer,
        bytes: u64,
    ) {
        self.commands.push(Command::Copy {
            from,
            offset,
            to,
            bytes,
        });
    }

    /// Runs the commands one by one, waits for each, and adds what each took to its kernel's time.
    ///
    /// # Errors
    /// As [`Self::submit`].
    pub(super) fn submit_timed(
        self,
        times: &mut KernelTimes,
    ) -> Result<wgpu::SubmissionIndex, Error> {
        let (device, label) = (self.device, self.label);
        let mut last = Self::new(device, label).submit()?;
        for command in self.commands {
            let name = match &command {
                Command::Dispatch(kernel, ..) => kernel.name(),
                Command::Clear(..) | Command::Copy { .. } => "clearing and copying",
            };
            let mut alone = Self::new(device, label);
            alone.commands.push(command);
            device.wait_for(last)?;
            let began = times.now();
            last = alone.submit()?;
            device.wait_for(last.clone())?;
            times.add(name, began);
        }
        Ok(last)
    }

    /// Hands everything to the device and does not wait.
    ///
    /// # Errors
    /// [`Error::Lost`] or [`Error::Rejected`].
    pub(super) fn submit(self) -> Result<wgpu::SubmissionIndex, Error> {
        let device = self.device;
        let descriptor = wgpu::CommandEncoderDescriptor {
            label: Some(self.label),
        };
        let index = device.checked(self.label, || {
            let mut encoder = device.device.create_command_encoder(&descriptor);
            for command in &self.commands {
                match command {
                    Command::Dispatch(kernel, bound, groups) => {
                        kernel.encode(&mut encoder, bound, *groups);
                    }
                    Command::Clear(buffer, bytes) => encoder.clear_buffer(buffer, 0, Some(*bytes)),
                    Command::Copy {
                        from,
                        offset,
                        to,
                        bytes,
                    } => encoder.copy_buffer_to_buffer(from, *offset, to, 0, *bytes),
                }
            }
            device.queue.submit([encoder.finish()])
        })?;
        for command in &self.commands {
            if matches!(command, Command::Dispatch(..)) {
                device.count_dispatch();
            }
        }
        Ok(index)
    }
}
