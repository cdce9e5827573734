//! Merged rendering on the device: the counterpart of `scene::render`.
//!
//! A frame is rendered in batches of tiles. For each batch the host plans rays and pairs (a ray and an object whose box it may cross);
//! kernels cast them, march the objects, march the background and merge it with the objects' samples, list the samples that
//! weigh enough, and colour those field by field. The host turns what rays show into pixels and their owners.

mod asset;

mod shelf;

mod kernels;

mod workspace;

mod plan;

mod eye;

mod batch;

mod color;

mod resolve;

mod frame;

use std::sync::{Arc, Mutex, PoisonError};

use glam::Vec3;

use super::device::Device;
use super::error::Error;
use crate::Result;
use crate::field::{ColorMlp, DensityActivation, Field, Occupancy};
use crate::scene::{Prepared, RenderOptions, RenderedFrame, Scene, assemble};
use batch::Staged;
use frame::Frame;
use kernels::SceneKernels;
use shelf::{Pinned, Shelf};
use workspace::{Room, Workspace};

/// Optical depth that takes half of the light.
const HALF_TAU: f32 = std::f32::consts::LN_2;

/// Renders scenes on one device.
#[derive(Debug)]
pub(super) struct SceneRenderer {
    kernels: SceneKernels,
    shelf: Shelf,
    /// What takes the background's place where there is none.
    nothing: Arc<Field>,
    /// Of renders that have ended, for the next.
    workspaces: Mutex<Vec<(Workspace, Room)>>,
}

impl SceneRenderer {
    /// Keeps assets of `memory_bytes` between renders.
    pub(super) fn new(device: &Device, memory_bytes: u64) -> Result<Self, Error> {
        Ok(Self {
            kernels: SceneKernels::new(device)?,
            shelf: Shelf::new(memory_bytes),
            nothing: Arc::new(nothing()),
            workspaces: Mutex::default(),
        })
    }

    /// Bytes of the assets on the device.
    pub(super) fn resident_bytes(&self) -> u64 {
        self.shelf.bytes()
    }

    /// See [`crate::backend::Backend::render`].
    pub(super) fn render(
        &self,
        device: &Device,
        scene: &Scene<'_>,
        options: &RenderOptions,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<RenderedFrame> {
        let prepared = Prepared::checked(scene, options)?;
        let background = prepared.background.unwrap_or(&self.nothing);
        let background = self.shelf.get(device, background, cancelled)?;
        let objects = prepared.objects.iter();
        let objects: Vec<Pinned<'_>> = objects
            .map(|object| self.shelf.get(device, object.field, cancelled))
            .collect::<Result<_, Error>>()?;
        let staged = Staged {
            device,
            kernels: &self.kernels,
            scene: &prepared,
            background: &background.asset,
            objects: objects.iter().map(|object| &*object.asset).collect(),
        };
        let (mut work, mut room) = self.workspace(device)?;
        let tiles = Frame::new(&staged).render(&mut work, &mut room, cancelled)?;
        self.workspaces
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push((work, room));
        Ok(assemble(&prepared, tiles))
    }

    fn workspace(&self, device: &Device) -> Result<(Workspace, Room), Error> {
        let free = self
            .workspaces
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop();
        match free {
            Some(free) => Ok(free),
            None => Ok((Workspace::new(device)?, Room::default())),
        }
    }
}

/// A field in which nothing is.
fn nothing() -> Field {
    Field {
        bounds_m: (Vec3::ZERO, Vec3::ZERO),
        levels: Vec::new(),
        activation: DensityActivation::from_alpha(1e-6, 1.0),
        mlp: ColorMlp::new(ColorMlp::WIDTHS[0], || 0.5),
        sky: None,
        occupancy: Occupancy::new(1.0, Vec3::ZERO, Vec3::ONE).expect("one block"),
        step_growth: 0.0,
    }
}
