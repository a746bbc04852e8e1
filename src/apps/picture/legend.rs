//! The legend: a swatch, the label and the share of the surface of each part, the largest first.

use super::font;
use super::image::Image;
use super::shade::{GREY, linear};

/// Colour of the shares, and of the labels.
const DARK: [f32; 3] = [0.02; 3];
const PALE: [f32; 3] = [0.30; 3];

/// A line of the legend.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    label: usize,
    colour: [u8; 3],
    share: f64,
}

/// A legend ready to be drawn.
#[derive(Clone, Debug)]
pub(super) struct Legend {
    entries: Vec<Entry>,
    /// Parts that found no room.
    more: usize,
    dot: f64,
}

impl Legend {
    /// The legend for a picture of `width` × `height`; none where it is too small, or there is only one part.
    pub(super) fn of(areas: &[f64], colours: &[[u8; 3]], width: usize, height: usize) -> Option<Self> {
        let total: f64 = areas.iter().sum();
        let mut entries: Vec<Entry> = areas
            .iter()
            .enumerate()
            .filter(|(_, area)| **area > 0.0)
            .map(|(label, area)| Entry {
                label,
                colour: colours.get(label).copied().unwrap_or(GREY),
                share: area / total,
            })
            .collect();
        entries.sort_by(|a, b| b.share.total_cmp(&a.share).then(a.label.cmp(&b.label)));
        if entries.len() < 2 || height < 160 || width < 240 {
            return None;
        }
        let dot = (height.min(width) as f64 / 520.0).clamp(1.0, 12.0);
        let room = ((height as f64 - 20.0 * dot) / (13.0 * dot)) as usize;
        let more = if entries.len() > room { entries.len() + 1 - room } else { 0 };
        entries.truncate(entries.len() - more);
        Some(Self { entries, more, dot })
    }

    /// Pixels the legend takes at the picture's right side.
    pub(super) fn width(&self) -> usize {
        (self
            .texts()
            .map(|(label, share)| font::width(&label, self.dot) + font::width(&share, self.dot))
            .fold(0.0, f64::max)
            + 36.0 * self.dot) as usize
    }

    fn texts(&self) -> impl Iterator<Item = (String, String)> + '_ {
        self.entries.iter().map(|entry| (entry.label.to_string(), format!("{:.1} %", 100.0 * entry.share)))
    }

    /// Draws it at the right side, in the middle of the height.
    pub(super) fn draw(&self, image: &mut Image) {
        let dot = self.dot;
        let line = 13.0 * dot;
        let lines = self.entries.len() + usize::from(self.more > 0);
        let mut top = (image.height as f64 - lines as f64 * line) / 2.0;
        let left = (image.width - self.width().min(image.width)) as f64;
        let right = image.width as f64 - 10.0 * dot;
        for (entry, (label, share)) in self.entries.iter().zip(self.texts().collect::<Vec<_>>()) {
            swatch(image, left + 2.0 * dot, top - dot, 9.0 * dot, entry.colour);
            font::write(image, &label, left + 16.0 * dot, top, dot, PALE);
            font::write(image, &share, right - font::width(&share, dot), top, dot, DARK);
            top += line;
        }
        if self.more > 0 {
            font::write(image, &format!("+ {} more", self.more), left + 2.0 * dot, top, dot, PALE);
        }
    }
}

/// A disc of a colour.
fn swatch(image: &mut Image, left: f64, top: f64, size: f64, colour: [u8; 3]) {
    let colour = colour.map(linear);
    let radius = size / 2.0;
    for y in top.max(0.0) as usize..(top + size + 1.0).max(0.0) as usize {
        for x in left.max(0.0) as usize..(left + size + 1.0).max(0.0) as usize {
            let away = (x as f64 + 0.5 - left - radius).hypot(y as f64 + 0.5 - top - radius);
            let opacity = (radius - away + 0.5).clamp(0.0, 1.0) as f32;
            let rim = if away > radius - (size / 12.0).max(1.0) { 0.5 } else { 1.0 } * opacity;
            image.blend(x, y, [colour[0] * rim, colour[1] * rim, colour[2] * rim, opacity]);
        }
    }
}
