//! Matches damaged masks of many generated logs:
//! `cargo run --release -p backlot-e2e --example mask_matching -- WORLDS SEEDS [RETURNS_OF_OTHERS GROWN]`.
//!
//! The last two are limits in place of the defaults. Prints, for each way of telling merged masks, how many intact masks are matched right and how many masks are matched wrongly.

use backlot_e2e::damaged_masks::damage;
use backlot_e2e::logs;
use backlot_e2e::mask_score::{Score, matched};
use backlot_server::ingest::MaskMatching;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let mut number = |default: u64| arguments.next().map_or(Ok(default), |a| a.parse());
    let (worlds, seeds) = (number(3)?, number(24)?);
    let mut default = MaskMatching::default();
    for limit in [&mut default.most_returns_of_others, &mut default.most_grown] {
        if let Some(written) = arguments.next() {
            *limit = written.parse()?;
        }
    }
    let ways = [
        ("pixels", false, false),
        ("pixels and returns", true, false),
        ("pixels and neighbours", false, true),
        ("all", true, true),
    ];
    let ways = ways.map(|(name, by_returns, by_neighbours)| {
        let off = |on: bool, limit: f64| if on { limit } else { 1.0 };
        let matching = MaskMatching {
            most_returns_of_others: off(by_returns, default.most_returns_of_others),
            most_grown: off(by_neighbours, default.most_grown),
            ..default
        };
        (name, matching)
    });
    let mut scores = ways.map(|(name, matching)| (name, matching, Score::default()));
    for world in 0..worlds {
        let whole = logs::crowded(5 + world);
        for seed in 0..seeds {
            let mut log = logs::copy(&whole);
            let truths = damage(&mut log, 11 + seed);
            for (name, matching, sum) in &mut scores {
                let score = Score::of(&matched(&log, matching), &truths);
                let (world, seed) = (5 + world, 11 + seed);
                for wrong in &score.wrong {
                    println!("{name}, world {world}, seed {seed}: {wrong}");
                }
                if !score.finds_enough() {
                    println!(
                        "{name}, world {world}, seed {seed}: {} of {}",
                        score.right, score.intact
                    );
                }
                sum.add(score);
            }
        }
    }
    for (name, _, score) in &scores {
        println!(
            "{name}: {} of {} intact masks right, {} of {} damaged ones wrong",
            score.right,
            score.intact,
            score.wrong.len(),
            score.damaged
        );
    }
    Ok(())
}
