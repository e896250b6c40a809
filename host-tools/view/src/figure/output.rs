//! Figures as files: SVG with text as text, PNG with a font of our own, and SVG to embed in a page.

use std::{io::BufWriter, path::Path, sync::Once};

use image::{ColorType, ImageEncoder, codecs::png::PngEncoder};
use inerter_data::{
    output::{OutputError, Pending},
    words::printable_lines,
};
use plotters::{
    prelude::{BitMapBackend, IntoDrawingArea, SVGBackend},
    style::{FontStyle, register_font},
};

use super::{
    Colour, Figure, WIDTH_PX, css,
    draw::{Pen, TITLE_PX, draw},
};

/// Units per pixel of an SVG: plotters uses integer coordinates.
const SVG_SCALE: u32 = 10;
/// Pixels of a PNG per pixel of the figure, in each direction: 300 dots per inch at 6 inches of width.
const PNG_SCALE: u32 = 3;
/// Oversampling of a PNG, in each direction: plotters does not antialias wide lines.
const FINE: u32 = 2;
const CHANNELS: usize = 3;

/// The font that measures text, and draws it in a PNG; no system library is used.
fn register_fonts() {
    static ONCE: Once = Once::new();
    // Fails only for bytes that are not a font.
    ONCE.call_once(|| drop(register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular())));
}

/// The figure as an SVG document, with its title.
pub fn svg(figure: &Figure) -> String {
    drawn(figure, true)
}

/// The figure as an SVG element for a page: without a title, colours as CSS variables, labelled for screen readers.
pub fn svg_for_page(figure: &Figure) -> String {
    let plain = drawn(figure, false);
    Colour::ALL.into_iter().fold(plain, |text, colour| {
        text.replace(&format!("\"{}\"", css(colour.rgb())), &format!("\"var({})\"", colour.variable()))
    })
}

fn drawn(figure: &Figure, titled: bool) -> String {
    register_fonts();
    let height_px = figure.height_px() + if titled { TITLE_PX } else { 0 };
    let (width, height) = (WIDTH_PX * SVG_SCALE, height_px * SVG_SCALE);
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, (width, height)).into_drawing_area();
        // Writing to a string cannot fail.
        draw(figure, &root, Pen { scale: SVG_SCALE.into(), piecewise: false }, titled).ok();
        root.present().ok();
    }
    // Fine units, nominal size; the element's accessible name is its title.
    let head = format!("<svg width=\"{width}\" height=\"{height}\" ");
    let scaled = format!("<svg role=\"img\" width=\"{WIDTH_PX}\" height=\"{height_px}\" ");
    let title = format!(">\n<title>{}</title>\n", escaped(&figure.title));
    // Names of files are in it.
    printable_lines(&text.replacen(&head, &scaled, 1).replacen(">\n", &title, 1)).into_owned()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Writes the figure as a PNG file. Replaces an existing file only with `replace`.
pub fn render_png(figure: &Figure, path: &Path, replace: bool) -> Result<(), OutputError> {
    register_fonts();
    // Reports a file that cannot be created before the work begins.
    let pending = Pending::create(path, replace)?;
    let failed =
        |error: &dyn std::fmt::Display| OutputError::write(pending.name(), std::io::Error::other(error.to_string()));
    let (width, height) = (WIDTH_PX * PNG_SCALE, (figure.height_px() + TITLE_PX) * PNG_SCALE);
    let mut fine = vec![0; (width * FINE * height * FINE) as usize * CHANNELS];
    {
        let root = BitMapBackend::with_buffer(&mut fine, (width * FINE, height * FINE)).into_drawing_area();
        let pen = Pen { scale: (PNG_SCALE * FINE).into(), piecewise: true };
        draw(figure, &root, pen, true).map_err(|error| failed(&error))?;
        root.present().map_err(|error| failed(&error))?;
    }
    let pixels = halved(&fine, (width * FINE) as usize);
    let encoder = PngEncoder::new(BufWriter::new(pending.open()?));
    encoder.write_image(&pixels, width, height, ColorType::Rgb8).map_err(|error| failed(&error))?;
    pending.commit().map(drop)
}

/// Averages blocks of two by two pixels; `width` is that of a fine row.
fn halved(fine: &[u8], width: usize) -> Vec<u8> {
    let row = width * CHANNELS;
    let mut pixels = Vec::with_capacity(fine.len() / 4);
    for rows in fine.chunks_exact(2 * row) {
        let (upper, lower) = rows.split_at(row);
        for (upper, lower) in upper.chunks_exact(2 * CHANNELS).zip(lower.chunks_exact(2 * CHANNELS)) {
            for left in 0..CHANNELS {
                let right = left + CHANNELS;
                let above = u16::from(upper[left]) + u16::from(upper[right]);
                let below = u16::from(lower[left]) + u16::from(lower[right]);
                pixels.push(((above + below + 2) / 4) as u8);
            }
        }
    }
    pixels
}
