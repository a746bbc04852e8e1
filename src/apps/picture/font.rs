//! A few glyphs of five by seven dots for the legend, drawn smoothly at any size.

use super::image::Image;

/// Rows of each glyph from the top, the leftmost dot in the highest of five bits.
const GLYPHS: [(char, [u8; 7]); 17] = [
    ('0', [0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('2', [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111]),
    ('3', [0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110]),
    ('4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    ('5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    ('6', [0b01110, 0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    ('7', [0b11111, 0b00001, 0b00010, 0b00100, 0b00100, 0b01000, 0b01000]),
    ('8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    ('9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00001, 0b01110]),
    ('.', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00100, 0b00100]),
    ('%', [0b11000, 0b11001, 0b00010, 0b00100, 0b01000, 0b10011, 0b00011]),
    ('+', [0b00000, 0b00100, 0b00100, 0b11111, 0b00100, 0b00100, 0b00000]),
    ('m', [0b00000, 0b00000, 0b11010, 0b10101, 0b10101, 0b10101, 0b10101]),
    ('o', [0b00000, 0b00000, 0b01110, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('r', [0b00000, 0b00000, 0b10110, 0b11001, 0b10000, 0b10000, 0b10000]),
    ('e', [0b00000, 0b00000, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110]),
];

/// Pixels that `text` takes at `dot` pixels a dot.
pub(super) fn width(text: &str, dot: f64) -> f64 {
    text.chars().map(advance).sum::<f64>() * dot
}

/// Dots from a glyph to the next.
fn advance(c: char) -> f64 {
    match c {
        '.' => 3.5,
        ' ' => 3.0,
        _ => 6.2,
    }
}

/// Writes `text` in linear `colour` with its upper left corner at (`x`, `y`).
pub(super) fn write(image: &mut Image, text: &str, x: f64, y: f64, dot: f64, colour: [f32; 3]) {
    let mut left = x;
    for c in text.chars() {
        let shift = if c == '.' { -1.0 } else { 0.0 };
        if let Some((_, rows)) = GLYPHS.iter().find(|(known, _)| *known == c) {
            glyph(image, rows, left + shift * dot, y, dot, colour);
        }
        left += advance(c) * dot;
    }
}

fn glyph(image: &mut Image, rows: &[u8; 7], left: f64, top: f64, dot: f64, colour: [f32; 3]) {
    let lit = |i: i64, j: i64| {
        f64::from(u8::from((0..5).contains(&i) && (0..7).contains(&j) && rows[j as usize] >> (4 - i) & 1 == 1))
    };
    for y in (top - dot).floor().max(0.0) as usize..(top + 8.0 * dot).ceil().max(0.0) as usize {
        for x in (left - dot).floor().max(0.0) as usize..(left + 6.0 * dot).ceil().max(0.0) as usize {
            let (u, v) = ((x as f64 + 0.5 - left) / dot - 0.5, (y as f64 + 0.5 - top) / dot - 0.5);
            let (i, j) = (u.floor(), v.floor());
            let (a, b) = (u - i, v - j);
            let (i, j) = (i as i64, j as i64);
            let value = (lit(i, j) * (1.0 - a) + lit(i + 1, j) * a) * (1.0 - b)
                + (lit(i, j + 1) * (1.0 - a) + lit(i + 1, j + 1) * a) * b;
            // The dots' blurred outline, cut where it is half: round corners, no steps.
            let opacity = ((value - 0.45) * dot.max(1.0) * 0.9 + 0.5).clamp(0.0, 1.0) as f32;
            image.blend(x, y, [colour[0] * opacity, colour[1] * opacity, colour[2] * opacity, opacity]);
        }
    }
}
