//! Whose turn it is on a device: renders go before training, and training is never starved.
//!
//! [`Turns`] decides, as a pure function of what happened; [`Gate`] makes threads wait for it.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Who gets the device first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Priority {
    /// Somebody waits for the picture.
    Render,
    /// Runs for hours anyway.
    Training,
}

/// Turns that renders may take one after the other while training waits: training keeps a fifth of the device.
const RENDERS_IN_A_ROW: u32 = 4;

/// Tickets that wait and the one that has the device. One turn is some tens of milliseconds of work.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns {
    /// In order of arrival.
    waiting: Vec<(u64, Priority)>,
    holder: Option<u64>,
    next_ticket: u64,
    /// Renders since training last had a turn, up to [`RENDERS_IN_A_ROW`]: the one that begins while training is about to ask again
    /// counts as well.
    in_a_row: u32,
}

impl Turns {
    /// Joins the queue.
    pub(super) fn ask(&mut self, priority: Priority) -> u64 {
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        self.waiting.push((ticket, priority));
        self.hand_on();
        ticket
    }

    /// Whether it is this ticket's turn.
    pub(super) fn is_up(&self, ticket: u64) -> bool {
        self.holder == Some(ticket)
    }

    /// Whether anybody waits for a turn.
    pub(super) fn is_wanted(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Leaves the queue, or ends the turn.
    pub(super) fn leave(&mut self, ticket: u64) {
        if self.holder == Some(ticket) {
            self.holder = None;
        }
        self.waiting.retain(|(own, _)| *own != ticket);
        self.hand_on();
    }

    fn hand_on(&mut self) {
        if self.holder.is_some() {
            return;
        }
        let first = |wanted: Priority| self.waiting.iter().position(|(_, own)| *own == wanted);
        let (render, training) = (first(Priority::Render), first(Priority::Training));
        let next = match (render, training) {
            (Some(render), Some(training)) => {
                if self.in_a_row < RENDERS_IN_A_ROW {
                    self.in_a_row += 1;
                    render
                } else {
                    self.in_a_row = 0;
                    training
                }
            }
            (Some(render), None) => {
                self.in_a_row = (self.in_a_row + 1).min(RENDERS_IN_A_ROW);
                render
            }
            (None, Some(training)) => {
                self.in_a_row = 0;
                training
            }
            (None, None) => return,
        };
        self.holder = Some(self.waiting.remove(next).0);
    }
}

/// Makes threads wait for their turns.
#[derive(Debug, Default)]
pub(super) struct Gate {
    turns: Mutex<Turns>,
    moved: Condvar,
}

/// The device is the holder's until this is dropped.
#[derive(Debug)]
pub(super) struct Turn<'a> {
    gate: &'a Gate,
    ticket: u64,
}

impl Gate {
    /// Waits for a turn.
    pub(super) fn turn(&self, priority: Priority) -> Turn<'_> {
        let mut turns = self.lock();
        let turn = Turn {
            gate: self,
            ticket: turns.ask(priority),
        };
        while !turns.is_up(turn.ticket) {
            turns = self
                .moved
                .wait(turns)
                .unwrap_or_else(PoisonError::into_inner);
        }
        turn
    }

    fn lock(&self) -> MutexGuard<'_, Turns> {
        // Turns change by whole steps: a panic elsewhere leaves them sound.
        self.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Turn<'_> {
    /// Whether anybody waits for the device.
    pub(super) fn is_wanted(&self) -> bool {
        self.gate.lock().is_wanted()
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.gate.lock().leave(self.ticket);
        self.gate.moved.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_render_goes_before_training_that_came_first() {
        let mut turns = Turns::default();
        let running = turns.ask(Priority::Training);
        let training = turns.ask(Priority::Training);
        let render = turns.ask(Priority::Render);
        assert!(turns.is_up(running) && turns.is_wanted());
        turns.leave(running);
        assert!(turns.is_up(render) && !turns.is_up(training));
        turns.leave(render);
        assert!(turns.is_up(training) && !turns.is_wanted());
    }

    #[test]
    fn training_gets_a_fifth_of_the_turns_under_endless_renders() {
        let mut turns = Turns::default();
        let mut training = turns.ask(Priority::Training);
        let mut renders = [turns.ask(Priority::Render), turns.ask(Priority::Render)];
        turns.leave(training);
        training = turns.ask(Priority::Training);
        let (mut trained, mut rendered) = (0, 0);
        for _ in 0..100 {
            if turns.is_up(training) {
                trained += 1;
                turns.leave(training);
                training = turns.ask(Priority::Training);
                continue;
            }
            let up = renders.iter_mut().find(|ticket| turns.is_up(**ticket));
            let up = up.expect("somebody has the device");
            rendered += 1;
            turns.leave(*up);
            *up = turns.ask(Priority::Render);
        }
        assert_eq!((trained, rendered), (20, 80));
    }

    proptest! {
        #[test]
        fn the_device_is_never_idle_nor_shared(steps in prop::collection::vec((0u8..3, 0usize..6), 1..120)) {
            let mut turns = Turns::default();
            let mut tickets = Vec::new();
            for (what, which) in steps {
                match what {
                    0 => tickets.push(turns.ask(Priority::Render)),
                    1 => tickets.push(turns.ask(Priority::Training)),
                    _ if tickets.is_empty() => {}
                    _ => {
                        let ticket = tickets.remove(which % tickets.len());
                        turns.leave(ticket);
                    }
                }
                let up = tickets.iter().filter(|ticket| turns.is_up(**ticket)).count();
                prop_assert_eq!(up, usize::from(!tickets.is_empty()));
            }
        }
    }

    #[test]
    fn threads_wait_for_each_other() {
        let gate = Gate::default();
        let inside = std::sync::atomic::AtomicU32::new(0);
        let order = std::sync::atomic::Ordering::SeqCst;
        std::thread::scope(|scope| {
            for priority in [Priority::Render, Priority::Training, Priority::Render] {
                let (gate, inside) = (&gate, &inside);
                scope.spawn(move || {
                    for _ in 0..200 {
                        let _turn = gate.turn(priority);
                        assert_eq!(inside.fetch_add(1, order), 0);
                        inside.fetch_sub(1, order);
                    }
                });
            }
        });
    }
}
