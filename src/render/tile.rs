//! What is kept of a tile's pixels while it is drawn: 1/z and attributes of the nearest surface, 1/z and normal of
//! the second-nearest. Nothing is shaded here: a pixel is, once, when the tile is written to the layer.

use super::setup::Setup;
use crate::pixels::TILE;

/// Pixels from one row to the next: runs may reach past a tile's right edge, and what they leave there is junk.
pub(super) const STRIDE: usize = TILE + 8;

/// Tiles in a row at most, in words of 64.
pub(super) const ROW_WORDS: usize = super::MAX_SIDE / TILE / 64;

/// Pixels of a slot.
const AREA: usize = STRIDE * TILE;

/// Room of a slot's planes: a little past a power of two, so that whether four pixels from one on are within is asked by
/// an instruction that holds the number.
pub(super) const ROOM: usize = AREA.next_power_of_two() + 4;

/// What the frame keeps of a pixel beside 1/z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Channels {
    /// Intensity.
    pub light: bool,
    /// Whether any face has one intensity.
    pub flat: bool,
    /// Normals.
    pub normals: bool,
    /// Texture coordinates.
    pub uv: bool,
    /// Vertex colors.
    pub colors: bool,
    /// Which surface it is: where there is more than one.
    pub surfaces: bool,
    /// The second layer; normals are then on.
    pub second: bool,
    /// What phantoms hide.
    pub phantoms: bool,
}

/// Attributes of a fragment at most: intensity, normal, texture coordinates, color.
pub(super) const MOST: usize = 9;

/// One value of a slot's pixels.
pub(super) type Values = [f32; ROOM];

impl Channels {
    /// Where the second layer is among the other planes: 1/z, then the normal. Intensity is the first of them.
    pub fn second_at(self) -> usize {
        1
    }

    /// Where the texture coordinates are.
    pub fn uv_at(self) -> usize {
        self.second_at() + if self.second { 4 } else { 0 }
    }

    /// Where the vertex color is.
    pub fn color_at(self) -> usize {
        self.uv_at() + if self.uv { 2 } else { 0 }
    }

    /// Where 1/z of what hides is.
    pub fn shield_at(self) -> usize {
        self.color_at() + if self.colors { 3 } else { 0 }
    }

    /// Both.
    pub fn join(self, other: Self) -> Self {
        Self {
            light: self.light | other.light,
            flat: self.flat | other.flat,
            normals: self.normals | other.normals,
            uv: self.uv | other.uv,
            colors: self.colors | other.colors,
            surfaces: self.surfaces | other.surfaces,
            second: self.second | other.second,
            phantoms: self.phantoms | other.phantoms,
        }
    }

    /// How many attributes there are beside light.
    pub fn others(self) -> usize {
        let count = |wanted: bool, count| if wanted { count } else { 0 };
        count(self.normals, 3) + count(self.uv, 2) + count(self.colors, 3)
    }
}

/// The pixels of one tile while it is drawn; row by row, `STRIDE` from one to the next. The tiles of a row of tiles
/// are drawn in the same slot, one after the other.
#[derive(Default)]
pub(super) struct Slot {
    /// The columns of tiles with a covered pixel inside the picture, a bit each.
    pub covered: [u64; ROW_WORDS],
    /// Of the nearest surface: 1/z, `nothing` where there is none, and its normal over z, unspecified where there is none.
    pub near: Vec<Values>,
    /// All else over z, as `Channels` says. Two pieces of memory: one address each leads to all of it, and compilers do
    /// not see that the two are apart. Where they see that, they make masked stores of what is read, selected from and
    /// written: slow where the next triangle reads it.
    pub others: Vec<Values>,
    /// Its index among the frame's surfaces; unspecified where there is only one.
    pub surface: Vec<i32>,
    /// Where triangles are set up: of one and of its strips.
    pub setups: [Setup; 2],
}

impl Slot {
    /// Allocates what frames may keep.
    pub fn fit(&mut self, channels: Channels) {
        self.near.resize(if channels.normals { 4 } else { 1 }, [0.0; ROOM]);
        self.others.resize(channels.shield_at() + usize::from(channels.phantoms), [0.0; ROOM]);
        self.surface.resize(if channels.surfaces { ROOM } else { 0 }, 0);
    }

    /// 1/z of the nearest surface.
    pub fn w(&self) -> &Values {
        &self.near[0]
    }

    /// Intensity over z of the nearest surface; of flat faces intensity itself.
    pub fn light(&self) -> &Values {
        &self.others[0]
    }

    /// No surface anywhere, of what this frame keeps.
    pub fn clear(&mut self, channels: Channels, nothing: f32) {
        fill(&mut self.near[0], nothing);
        if channels.second {
            fill(&mut self.others[channels.second_at()], nothing);
        }
        if channels.phantoms {
            fill(&mut self.others[channels.shield_at()], nothing);
        }
    }
}

/// In blocks, of which `AREA` is a whole number: fewer steps than one by one.
fn fill(plane: &mut [f32], value: f32) {
    let (blocks, _) = plane.as_chunks_mut::<16>();
    blocks.iter_mut().take(AREA / 16).for_each(|block| *block = [value; 16]);
}

/// What stands for no surface: the largest 1/z beyond the far plane, so that nothing there is ever nearer.
pub(super) fn nothing(far: f64) -> f32 {
    let least = (1.0 / far) as f32;
    if least > 0.0 { least.next_down() } else { 0.0 }
}
