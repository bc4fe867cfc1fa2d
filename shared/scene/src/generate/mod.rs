//! Seeded generators: scenes that need no files, the same to the last bit on every machine.
//!
//! | kind | what it is | stands in for |
//! |---|---|---|
//! | `cornell` | a box with a red and a green wall, a mirror ball and a glass ball | |
//! | `hall` | a textured hall with columns and a polished floor: the demo | |
//! | `rooms` | storeys of furnished rooms, nearly every face its own quad | Soda Hall |
//! | `plant` | pipes, tanks and gratings in a tall steel frame | Power Plant |
//! | `city` | a street grid, most of it hidden from any street | Manhattan |
//!
//! A stand-in has the counts, proportions and kinds of triangles of its model, not its shape; figures measured on it are its
//! own and never the model's. Every scene's [`notes`](crate::Scene::notes) state the recipe and the measured [`Row`] beside the
//! model's. Lengths are metres, +y is up, and every scene brings its cameras and lights.

mod arches;
mod assembly;
mod city;
mod cornell;
mod fittings;
mod furnishing;
mod hall;
mod plant;
mod rng;
mod rooms;
mod row;
mod shapes;
mod textures;

use row::Reference;
pub use row::Row;

use crate::Scene;
use serde::Deserialize;
use std::fmt;

/// What to generate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A box with a mirror ball and a glass ball.
    Cornell,
    /// The demo's hall.
    Hall,
    /// Storeys of rooms.
    Rooms,
    /// Pipes, tanks and gratings in a steel frame.
    Plant,
    /// A street grid of houses.
    City,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Cornell, Self::Hall, Self::Rooms, Self::Plant, Self::City];

    /// Its name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cornell => "cornell",
            Self::Hall => "hall",
            Self::Rooms => "rooms",
            Self::Plant => "plant",
            Self::City => "city",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Everything that a generated scene depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Recipe {
    /// What.
    pub kind: Kind,
    /// Triangles wanted after instancing, in [`Recipe::TRIANGLES`]; the scene comes within 2 % of it.
    pub triangles: u32,
    /// Seed of everything that is left to chance.
    pub seed: u64,
}

impl Recipe {
    /// What can be asked for.
    pub const TRIANGLES: std::ops::RangeInclusive<u32> = 1_000..=12_750_000;
}

/// A recipe asks for too few or too many triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("triangles = {asked} is out of range; ask for {} to {}", Recipe::TRIANGLES.start(), Recipe::TRIANGLES.end())]
pub struct OutOfRange {
    /// What was asked for.
    pub asked: u32,
}

/// Makes the scene of a recipe.
pub fn generate(recipe: &Recipe) -> Result<Scene, OutOfRange> {
    if !Recipe::TRIANGLES.contains(&recipe.triangles) {
        return Err(OutOfRange { asked: recipe.triangles });
    }
    let (mut scene, model) = match recipe.kind {
        Kind::Cornell => (cornell::generate(recipe), None::<Reference>),
        Kind::Hall => (hall::generate(recipe), None),
        Kind::Rooms => (rooms::generate(recipe), Some(Reference::SODA_HALL)),
        Kind::Plant => (plant::generate(recipe), Some(Reference::POWER_PLANT)),
        Kind::City => (city::generate(recipe), None),
    };
    scene.notes.push(format!(
        "generated: kind {}, seed {}, {} triangles asked for",
        recipe.kind, recipe.seed, recipe.triangles
    ));
    scene.notes.push(format!("made: {}", Row::of(&scene).text()));
    if let Some(model) = model {
        scene.notes.push(format!(
            "stands in for {}, whose figures in Seo, Park, Ihm 2022 are: {}; figures measured here are not that model's",
            model.name,
            model.text()
        ));
    }
    Ok(scene)
}

#[cfg(test)]
mod tests;
