//! Draws the description with plotters, on any of its canvases.

use std::ops::Range;

use inerter_data::words::printable;
use plotters::{
    coord::{Shift, cartesian::Cartesian2d, ranged1d::Ranged},
    element::{Circle, DashedPathElement, PathElement, Polygon, Rectangle},
    prelude::{ChartBuilder, DrawingArea, DrawingBackend, IntoFont, RGBColor, TRANSPARENT, TextStyle},
    style::{
        Color, ShapeStyle,
        text_anchor::{HPos, Pos, VPos},
    },
};

use super::{
    Colour, Figure, Layer, Panel, Scale, Shape, Stroke, WIDTH_PX, decimate,
    scale::{Coordinate, around, ends},
};

type Failure<DB> = plotters::drawing::DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>;
type Plot<DB> = DrawingArea<DB, Cartesian2d<Coordinate, Coordinate>>;

/// Height of the title above all panels \[px\].
pub const TITLE_PX: u32 = 30;
/// Height of a panel's legend \[px\].
const LEGEND_PX: f64 = 22.0;
const TEXT_PX: f64 = 12.0;
/// Ratio of plotters' text size to the em size.
const TEXT_SIZE: f64 = 1.24;
/// Maximum length of a label that fits beside the name of the axis.
const SHORT_LABEL: usize = 7;
/// Pixels for each label of an axis, horizontally and vertically.
const LABEL_PX: [u32; 2] = [80, 36];

/// Canvas units per pixel, and a limitation of the canvas.
#[derive(Clone, Copy, Debug)]
pub struct Pen {
    /// Units per pixel; plotters uses integer coordinates.
    pub scale: f64,
    /// Whether wide lines must be drawn segment by segment: plotters' bitmap fills a wide line's outline, which
    /// overlaps.
    pub piecewise: bool,
}

impl Pen {
    fn units(self, px: f64) -> u32 {
        (px * self.scale).round().max(1.0) as u32
    }

    fn text<'a>(self, px: f64) -> TextStyle<'a> {
        ("sans-serif", px * TEXT_SIZE * self.scale).into_font().color(&colour(Colour::Ink))
    }

    fn line(self, of: Colour, stroke: Stroke) -> ShapeStyle {
        let (px, opacity) = match stroke {
            Stroke::Thin => (0.9, 1.0),
            Stroke::Solid | Stroke::Dashed => (1.6, 1.0),
            Stroke::Wide => (3.6, 0.5),
        };
        // With separate segments, transparent ends would show, so the line is a pale opaque colour.
        let pale = |part: u8| (f64::from(part) * opacity + 255.0 * (1.0 - opacity)).round() as u8;
        let [red, green, blue] = of.rgb().map(pale);
        let seen = if self.piecewise { RGBColor(red, green, blue).mix(1.0) } else { colour(of).mix(opacity) };
        seen.stroke_width(self.units(px))
    }
}

fn colour(of: Colour) -> RGBColor {
    let [red, green, blue] = of.rgb();
    RGBColor(red, green, blue)
}

/// Draws all panels, with the title above them if requested.
pub fn draw<DB: DrawingBackend>(
    figure: &Figure,
    root: &DrawingArea<DB, Shift>,
    pen: Pen,
    titled: bool,
) -> Result<(), Failure<DB>> {
    root.fill(&colour(Colour::Paper))?;
    let mut rest = root.clone();
    if titled {
        let (head, below) = rest.split_vertically(pen.units(TITLE_PX.into()));
        head.draw_text(&printable(&figure.title), &pen.text(14.0), (pen.units(12.0) as i32, pen.units(9.0) as i32))?;
        rest = below;
    }
    // The same for all panels, so that their axes align.
    let is_long = figure.panels.iter().any(|panel| axes(panel)[1].longest_label() > SHORT_LABEL);
    let left_px = if is_long { 84.0 } else { 68.0 };
    for panel in &figure.panels {
        let (area, below) = rest.split_vertically(pen.units(panel.height_px.into()));
        Drawing { root, pen, left_px }.panel(panel, &area)?;
        rest = below;
    }
    Ok(())
}

struct Drawing<'a, DB: DrawingBackend> {
    /// The whole canvas, for items placed in canvas units.
    root: &'a DrawingArea<DB, Shift>,
    pen: Pen,
    /// Room for the labels and the name of the left axis.
    left_px: f64,
}

/// The axes of a panel, horizontal and vertical.
fn axes(panel: &Panel) -> [Coordinate; 2] {
    let [across, upwards] = ranges(panel);
    let [x, y] = [WIDTH_PX / LABEL_PX[0], panel.height_px.saturating_sub(60) / LABEL_PX[1]].map(|count| count.max(3));
    [Coordinate::new(panel.x.scale, across, x as usize), Coordinate::new(panel.y.scale, upwards, y as usize)]
}

impl<DB: DrawingBackend> Drawing<'_, DB> {
    fn panel(&self, panel: &Panel, area: &DrawingArea<DB, Shift>) -> Result<(), Failure<DB>> {
        let pen = self.pen;
        let [x, y] = axes(panel);
        let (legend, body) = area.split_vertically(pen.units(LEGEND_PX));
        self.legend(panel, &legend)?;
        let mut chart = ChartBuilder::on(&body)
            .margin_right(pen.units(16.0))
            .margin_top(pen.units(4.0))
            .margin_left(pen.units(8.0))
            .x_label_area_size(pen.units(40.0))
            .y_label_area_size(pen.units(self.left_px))
            .build_cartesian_2d(x.clone(), y.clone())?;
        chart
            .configure_mesh()
            .axis_style(colour(Colour::Ink).stroke_width(pen.units(0.8)))
            .bold_line_style(colour(Colour::Grid).stroke_width(pen.units(0.7)))
            .light_line_style(TRANSPARENT)
            .set_all_tick_mark_size(pen.units(4.0) as i32)
            .label_style(pen.text(TEXT_PX))
            .axis_desc_style(pen.text(TEXT_PX))
            .x_desc(panel.x.label.as_str())
            .y_desc(panel.y.label.as_str())
            .x_label_formatter(&|value| x.label(*value))
            .y_label_formatter(&|value| y.label(*value))
            .draw()?;
        let plot = chart.plotting_area();
        for layer in &panel.layers {
            self.layer(layer, panel, plot, [&x.range(), &y.range()])?;
        }
        Ok(())
    }

    /// Names of the layers in a row, each after a sample of its line.
    fn legend(&self, panel: &Panel, area: &DrawingArea<DB, Shift>) -> Result<(), Failure<DB>> {
        let pen = self.pen;
        let text = pen.text(TEXT_PX).pos(Pos::new(HPos::Left, VPos::Center));
        let (left, top) = area.get_base_pixel();
        let (mut x, y) = (left + pen.units(70.0) as i32, top + pen.units(LEGEND_PX / 2.0 + 2.0) as i32);
        for layer in &panel.layers {
            let Some(label) = &layer.label else { continue };
            let end = x + pen.units(26.0) as i32;
            match &layer.shape {
                Shape::Line(_, stroke)
                | Shape::Band(_, stroke)
                | Shape::Level(_, stroke)
                | Shape::Instant(_, stroke) => {
                    let stroke = if *stroke == Stroke::Thin { Stroke::Solid } else { *stroke };
                    self.path(vec![(x, y), (end, y)], layer.colour, stroke)?;
                }
                Shape::Points(_) => self.dot(((x + end) / 2, y), layer.colour)?,
                Shape::Bars(_) | Shape::Span(..) => {
                    let half = pen.units(5.0) as i32;
                    self.area((x, y - half), (end, y + half), layer)?;
                }
            }
            let at = (end + pen.units(6.0) as i32, y);
            // As it is shown, so that the next one begins behind it.
            let label = printable(label);
            self.root.draw_text(&label, &text, at)?;
            // Without a font there is no text.
            let (width, _) = self.root.estimate_text_size(&label, &text).unwrap_or_default();
            x = at.0 + width as i32 + pen.units(22.0) as i32;
        }
        Ok(())
    }

    fn layer(
        &self,
        layer: &Layer,
        panel: &Panel,
        plot: &Plot<DB>,
        [x, y]: [&Range<f64>; 2],
    ) -> Result<(), Failure<DB>> {
        let within = |range: &Range<f64>, value: f64| (range.start..=range.end).contains(&value);
        let inside = |point: &(f64, f64)| point.0.is_finite() && point.1.is_finite() && within(x, point.0);
        // A line that leaves the panel vertically is broken: clipped to the edge it would look like data.
        let shown = |point: &(f64, f64)| inside(point) && within(y, point.1);
        let pixel = |point: (f64, f64)| plot.map_coordinate(&(point.0, point.1.clamp(y.start, y.end)));
        let line = |points: &[(f64, f64)], stroke: Stroke| {
            let mut runs = points.split(|point| !shown(point));
            runs.try_for_each(|run| self.path(self.thin(run, panel, x, pixel), layer.colour, stroke))
        };
        match &layer.shape {
            Shape::Line(points, stroke) => line(points, *stroke)?,
            Shape::Band(points, stroke) => {
                let whole = |(x, y, half): &(f64, f64, f64)| inside(&(*x, y - half)) && (y + half).is_finite();
                for run in points.split(|point| !whole(point)) {
                    let side = |sign: f64| -> Vec<_> { run.iter().map(|(x, y, half)| (*x, y + sign * half)).collect() };
                    let mut outline = self.thin(&side(1.0), panel, x, pixel);
                    outline.extend(self.thin(&side(-1.0), panel, x, pixel).into_iter().rev());
                    if outline.len() > 2 {
                        self.root.draw(&Polygon::new(outline, faint(layer.colour)))?;
                    }
                }
                line(&points.iter().map(|point| (point.0, point.1)).collect::<Vec<_>>(), *stroke)?;
            }
            Shape::Points(points) => {
                for (at, value, half) in points.iter().filter(|point| shown(&(point.0, point.1))) {
                    let ends = [value - half, value + half];
                    if ends.iter().all(|end| end.is_finite()) {
                        let ends = ends.map(|end| pixel((*at, end))).to_vec();
                        self.path(ends, layer.colour, Stroke::Thin)?;
                    }
                    self.dot(pixel((*at, *value)), layer.colour)?;
                }
            }
            Shape::Bars(bars) => {
                for (left, right, height) in bars.iter().filter(|bar| bar.2 > 0.0 && within(x, bar.0)) {
                    self.area(pixel((*left, *height)), pixel((*right, y.start)), layer)?;
                }
            }
            Shape::Level(value, stroke) if within(y, *value) => {
                self.path(vec![pixel((x.start, *value)), pixel((x.end, *value))], layer.colour, *stroke)?;
            }
            Shape::Instant(at, stroke) if within(x, *at) => {
                self.path(vec![pixel((*at, y.start)), pixel((*at, y.end))], layer.colour, *stroke)?;
            }
            Shape::Span(from, to) => {
                self.area(pixel((from.max(x.start), y.end)), pixel((to.min(x.end), y.start)), layer)?;
            }
            Shape::Level(..) | Shape::Instant(..) => {}
        }
        Ok(())
    }

    /// A series of points in canvas units, thinned to what the width can show.
    fn thin(
        &self,
        run: &[(f64, f64)],
        panel: &Panel,
        x: &Range<f64>,
        pixel: impl Fn((f64, f64)) -> (i32, i32),
    ) -> Vec<(i32, i32)> {
        let laid_out: Vec<_> = run.iter().map(|(x, y)| (panel.x.scale.apply(*x), *y)).collect();
        let range = panel.x.scale.apply(x.start)..panel.x.scale.apply(x.end);
        let thin = decimate::line(&laid_out, &range, WIDTH_PX as usize);
        let back = |(x, y): (f64, f64)| (panel.x.scale.undo(x), y);
        decimate::pixels(thin.into_iter().map(back).map(pixel), (self.pen.scale / 3.0).ceil() as i32)
    }

    fn path(&self, points: Vec<(i32, i32)>, of: Colour, stroke: Stroke) -> Result<(), Failure<DB>> {
        let style = self.pen.line(of, stroke);
        match points.as_slice() {
            [] => Ok(()),
            [only] => self.root.draw(&Circle::new(*only, style.stroke_width, style.filled())),
            _ if stroke == Stroke::Dashed => {
                let (dash, gap) = (self.pen.units(6.0), self.pen.units(4.0));
                self.root.draw(&DashedPathElement::new(points, dash, gap, style))
            }
            pieces if self.pen.piecewise => {
                pieces.windows(2).try_for_each(|piece| self.root.draw(&PathElement::new(piece.to_vec(), style)))
            }
            _ => self.root.draw(&PathElement::new(points, style)),
        }
    }

    fn dot(&self, at: (i32, i32), of: Colour) -> Result<(), Failure<DB>> {
        self.root.draw(&Circle::new(at, self.pen.units(2.6), colour(of).filled()))
    }

    fn area(&self, upper_left: (i32, i32), lower_right: (i32, i32), layer: &Layer) -> Result<(), Failure<DB>> {
        let style = if matches!(layer.shape, Shape::Bars(_)) {
            colour(layer.colour).mix(0.75).filled()
        } else {
            faint(layer.colour)
        };
        self.root.draw(&Rectangle::new([upper_left, lower_right], style))
    }
}

fn faint(of: Colour) -> ShapeStyle {
    colour(of).mix(0.22).filled()
}

/// The ranges of both axes: as given, or around all data; the vertical one around the visible data.
fn ranges(panel: &Panel) -> [(f64, f64); 2] {
    let corners: Vec<_> = panel.layers.iter().flat_map(|layer| corners(&layer.shape)).collect();
    let abscissas = || corners.iter().map(|(x, _)| *x).filter(|x| x.is_finite());
    let is_line = panel.layers.iter().any(|layer| matches!(layer.shape, Shape::Line(..) | Shape::Band(..)));
    let across = panel.x.range.unwrap_or_else(|| {
        let ends = ends(abscissas());
        // Lines over time begin and end at the panel's edges.
        let tight = is_line && panel.x.scale == Scale::Linear && ends.0 < ends.1;
        if tight { ends } else { around(panel.x.scale, abscissas()) }
    });
    let upwards = panel.y.range.unwrap_or_else(|| {
        let seen = corners.iter().filter(|(x, _)| x.is_nan() || (across.0..=across.1).contains(x));
        around(panel.y.scale, seen.map(|(_, y)| *y))
    });
    let bars = panel.layers.iter().any(|layer| matches!(layer.shape, Shape::Bars(_)));
    [across, if bars { (0.0, upwards.1) } else { upwards }]
}

/// The points of a shape that must be visible; NaN if there is no requirement.
fn corners(shape: &Shape) -> Vec<(f64, f64)> {
    match shape {
        Shape::Line(points, _) => points.clone(),
        Shape::Band(points, _) | Shape::Points(points) => {
            points.iter().flat_map(|(x, y, half)| [(*x, *y), (*x, y - half), (*x, y + half)]).collect()
        }
        Shape::Bars(bars) => {
            bars.iter().flat_map(|(left, right, height)| [(*left, *height), (*right, *height)]).collect()
        }
        Shape::Level(y, _) => vec![(f64::NAN, *y)],
        Shape::Instant(x, _) => vec![(*x, f64::NAN)],
        Shape::Span(..) => Vec::new(),
    }
}
