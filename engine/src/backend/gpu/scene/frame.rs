//! A frame batch by batch.

use std::time::{Duration, Instant};

use backlot_shaders::layout::{MarchParams, Ray, RaySample, RaySummary};
use wgpu::BufferUsages;

use super::batch::{Shown, Staged};
use super::plan::{Outline, Pixels, Plan, Tile, spread, tiles};
use super::resolve::{Question, Resolved};
use super::workspace::{Room, Workspace};
use crate::Result;
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::march::{march_buffers, march_kernel, to_device};
use crate::backend::gpu::pace::Pace;
use crate::backend::gpu::turns::Priority;
use crate::scene::TileResult;

/// Side of a tile, the least a batch can be: 256 rays and as many pairs with each object where small objects take sixteen a pixel.
const TILE_PX: u32 = 4;
/// A batch asks at its start and within.
const BATCH: Duration = Duration::from_millis(30);
/// Rays of a batch: four tiles, or less than one where small objects take sixteen a pixel; 64 Ki rays fill the largest card and take some 200 MiB of buffers.
const LEAST_RAYS: usize = 64;
const MOST_RAYS: usize = 1 << 16;
/// Rays of one dispatch that answers questions about static objects: 10 to 40 ms of marching in software.
const QUESTIONS_PER_DISPATCH: usize = 1 << 13;

/// A frame in the making.
pub(super) struct Frame<'a> {
    staged: &'a Staged<'a>,
    outlines: Vec<Outline>,
    /// Rays per pixel side where no small object is met.
    side: u32,
}

impl<'a> Frame<'a> {
    pub(super) fn new(staged: &'a Staged<'a>) -> Self {
        let objects = staged.scene.objects.iter();
        Self {
            staged,
            outlines: objects
                .map(|object| Outline {
                    pixels: object.pixels,
                    supersample: object.supersample,
                })
                .collect(),
            side: staged.scene.options.supersample.max(1),
        }
    }

    /// # Errors
    /// [`crate::Error::Cancelled`], asked before each batch and within, and the device's.
    pub(super) fn render(
        &self,
        work: &mut Workspace,
        room: &mut Room,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<Vec<TileResult>> {
        let staged = self.staged;
        let camera = &staged.scene.camera;
        let all = spread(&tiles(camera.width, camera.height, TILE_PX));
        let mut resolved = Resolved::new(staged.scene);
        let mut pace = Pace::new(BATCH, LEAST_RAYS, MOST_RAYS);
        let mut rest = &all[..];
        while !rest.is_empty() {
            let most = room.most_lists(staged.device.max_binding_bytes());
            let (count, pixels) = self.next_batch(rest, pace.rays().min(most));
            let turn = staged.device.turn(Priority::Render);
            if cancelled() {
                return Err(crate::Error::Cancelled);
            }
            let began = Instant::now();
            let (plan, shown) = match self.batch(work, room, &pixels, cancelled) {
                // Lists have grown since the batch was chosen: a smaller one fits.
                Err(Error::TooLarge { .. }) if count > 1 => continue,
                done => done?,
            };
            drop(turn);
            let (batch, after) = rest.split_at(count);
            rest = after;
            pace = pace.after(
                plan.requests.len() + plan.pair_requests.len(),
                began.elapsed(),
            );
            let mut first = 0;
            for tile in batch {
                resolved.take(*tile, first, &pixels, &plan, &shown);
                first += (tile.width * tile.height) as usize;
            }
        }
        let taus = self.answer(resolved.questions(), cancelled)?;
        Ok(resolved.answered(&taus))
    }

    /// What the batch's pixels show.
    fn batch(
        &self,
        work: &mut Workspace,
        room: &mut Room,
        pixels: &Pixels,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<(Plan, Shown), Error> {
        let sides = self.sides(work, room, pixels, cancelled)?;
        let plan = Plan::new(pixels, self.outlines.len(), |p| sides[p], |_, _| true);
        let shown = self.staged.render(work, room, &plan, cancelled)?;
        Ok((plan, shown))
    }

    /// How many of the tiles are taken next, at least one, and their pixels.
    fn next_batch(&self, rest: &[Tile], most_rays: usize) -> (usize, Pixels) {
        let mut rays = 0;
        let mut count = 0;
        for tile in rest {
            let own = Pixels::of(std::slice::from_ref(tile), &self.outlines);
            let most = |pixel: usize| {
                let side = own.probe_side(pixel, &self.outlines, self.side);
                let side = side.unwrap_or(self.side);
                (side * side) as usize * (1 + own.active(pixel).len())
            };
            rays += (0..own.len()).map(most).sum::<usize>();
            if count > 0 && rays > most_rays {
                break;
            }
            count += 1;
        }
        (count, Pixels::of(&rest[..count], &self.outlines))
    }

    /// Rays per side of every pixel: more where a small object is met.
    fn sides(
        &self,
        work: &mut Workspace,
        room: &mut Room,
        pixels: &Pixels,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Vec<u32>, Error> {
        let wanted = |pixel: usize| pixels.probe_side(pixel, &self.outlines, self.side);
        let small = |_: usize, object: u32| self.outlines[object as usize].supersample > self.side;
        let probe = Plan::new(
            pixels,
            self.outlines.len(),
            |pixel| wanted(pixel).unwrap_or(0),
            small,
        );
        if probe.pair_requests.is_empty() {
            return Ok(vec![self.side; pixels.len()]);
        }
        let met = self.staged.probe(work, room, &probe)?;
        if cancelled() {
            return Err(Error::Cancelled);
        }
        let meets = |pixel: usize| {
            let mut pairs = probe.rays(pixel).flat_map(|ray| probe.pairs(ray));
            pairs.any(|pair| met[*pair as usize].count > 0)
        };
        let side = |pixel: usize| wanted(pixel).filter(|_| meets(pixel)).unwrap_or(self.side);
        Ok((0..pixels.len()).map(side).collect())
    }

    /// Optical depths of the background along the questions' rays.
    fn answer(
        &self,
        questions: &[Question],
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<Vec<f32>> {
        let mut taus = Vec::with_capacity(questions.len());
        for questions in questions.chunks(QUESTIONS_PER_DISPATCH) {
            let _turn = self.staged.device.turn(Priority::Render);
            if cancelled() {
                return Err(crate::Error::Cancelled);
            }
            let rays: Vec<Ray> = questions.iter().map(|q| to_device(&q.ray)).collect();
            taus.extend(self.taus(&rays)?);
        }
        Ok(taus)
    }

    fn taus(&self, rays: &[Ray]) -> Result<Vec<f32>, Error> {
        let device = self.staged.device;
        let shape = &self.staged.background.shape;
        let kernel = march_kernel(device, shape)?;
        let groups = kernel.groups(device, rays.len() as u32);
        // No sample is recorded: only the sums are wanted.
        let params = MarchParams {
            ray_count: rays.len() as u32,
            sample_capacity: 0,
            groups_x: groups.x,
            ..shape.params
        };
        let storage = BufferUsages::STORAGE;
        let params =
            Buffer::from_slice(device, "march parameters", &[params], BufferUsages::UNIFORM)?;
        let rays_in = Buffer::from_slice(device, "questions", rays, storage)?;
        let summaries = Buffer::<RaySummary>::zeroed(device, "answers", rays.len(), storage)?;
        let samples = Buffer::<RaySample>::zeroed(device, "no samples", 1, storage)?;
        let own = [&params.raw, &rays_in.raw, &summaries.raw, &samples.raw];
        kernel.dispatch(device, groups, &march_buffers(shape, own))?;
        let summaries = summaries.read(device, rays.len())?;
        Ok(summaries.iter().map(|summary| summary.tau).collect())
    }
}
