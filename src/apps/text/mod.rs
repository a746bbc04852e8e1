//! Text on pictures and plots, from an embedded typeface, so that no system font is needed.
//!
//! `labels.ttf` (32 kB) has Latin, Greek and some mathematical glyphs of DejaVu Sans; its licence is beside it. Missing
//! glyphs are drawn as a box. Cost: microseconds per line of text.

use ab_glyph::{Font, FontRef, ScaleFont, point};

/// The typeface.
fn font() -> Option<FontRef<'static>> {
    FontRef::try_from_slice(include_bytes!("labels.ttf")).ok()
}

/// Width of `text` in pixels, at a height of capitals of about 0.73 `size`.
pub(super) fn width(text: &str, size: f64) -> f64 {
    let Some(font) = font() else { return 0. };
    let scaled = font.as_scaled(scale(&font, size));
    text.chars().map(|c| f64::from(scaled.h_advance(font.glyph_id(c)))).sum()
}

/// The scale at which one em is `size` pixels.
fn scale(font: &FontRef<'_>, size: f64) -> f32 {
    let em = font.units_per_em().unwrap_or(1000.);
    size as f32 * font.height_unscaled() / em
}

/// Calls `dot(x, y, coverage)` for the pixels of `text`, whose baseline starts at (`left`, `base`) and whose em is
/// `size` pixels.
pub(super) fn draw(text: &str, [left, base]: [f64; 2], size: f64, mut dot: impl FnMut(i64, i64, f32)) {
    let Some(font) = font() else { return };
    let size = scale(&font, size);
    let scaled = font.as_scaled(size);
    let mut x = left as f32;
    for c in text.chars() {
        let id = font.glyph_id(c);
        let glyph = id.with_scale_and_position(size, point(x, base as f32));
        if let Some(outline) = font.outline_glyph(glyph) {
            let corner = outline.px_bounds().min;
            let (left, top) = (corner.x as i64, corner.y as i64);
            outline.draw(|i, j, coverage| dot(left + i64::from(i), top + i64::from(j), coverage.clamp(0., 1.)));
        }
        x += scaled.h_advance(id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_as_wide_as_they_are_drawn_and_no_glyph_is_missing() {
        let missing = font().unwrap().glyph_id('\u{e000}');
        for text in ["Γ/n 12.5 % − λ²", "horse (97k), ½ × √3", "+ 4 more: é ß σ"] {
            assert!(text.chars().all(|c| font().unwrap().glyph_id(c) != missing), "{text}");
            let (mut right, mut ink) = (0, 0.);
            draw(text, [0., 20.], 16., |x, _, coverage| {
                right = if coverage > 0. { right.max(x) } else { right };
                ink += coverage;
            });
            let width = width(text, 16.);
            assert!(
                (right as f64) < width + 1. && right as f64 > width - 6. && ink > 50.,
                "{text}: {right} {width} {ink}"
            );
        }
        assert!(width("ii", 16.) < width("mm", 16.));
    }
}
