use super::*;

fn wave(count: usize) -> Figure {
    let points: Vec<_> =
        (0..count).map(|n| n as f64 * 1e-3).map(|t| (t, (20.0 * t).sin() + (3e3 * t).cos() * 0.1)).collect();
    let band = points.iter().map(|(t, y)| (*t, *y, 0.2)).collect();
    let panel = Panel {
        x: Axis::new("Time [s]"),
        y: Axis::new("Force [N]"),
        height_px: 200,
        layers: vec![
            Layer::unnamed(Colour::Blue, Shape::Band(band, Stroke::Thin)),
            Layer::new("measured & more", Colour::Blue, Shape::Line(points, Stroke::Thin)),
            Layer::new("model", Colour::Vermilion, Shape::Level(0.5, Stroke::Dashed)),
        ],
    };
    Figure { name: "wave", title: "A <wave>".into(), caption: String::new(), panels: vec![panel] }
}

#[test]
fn an_hour_makes_no_larger_a_file_than_a_minute() {
    let (minute, hour) = (svg(&wave(60_000)).len(), svg(&wave(3_600_000)).len());
    assert!((20_000..200_000).contains(&hour), "{hour} bytes");
    assert!(hour < 2 * minute, "{hour} against {minute} bytes");
}

#[test]
fn a_page_finds_every_colour_as_a_variable_and_text_as_text() {
    let (file, page) = (svg(&wave(1000)), svg_for_page(&wave(1000)));
    assert!(file.contains(&css(Colour::Blue.rgb())) && file.contains("A &lt;wave&gt;"));
    assert!(!page.contains("=\"#"), "{page}");
    assert!(page.contains("var(--blue)") && page.contains("measured &amp; more"), "{page}");
    assert!(page.contains("Time [s]") && page.contains("<title>"));
    let mut seen: Vec<_> = Colour::ALL.map(Colour::rgb).to_vec();
    seen.dedup();
    assert_eq!(seen.len(), Colour::ALL.len());
}

#[test]
fn invisible_characters_are_escaped_in_a_figure() {
    let name = "a\u{1b}[2J\n\u{202e}b\u{200b}\u{fe0f}";
    let mut figure = wave(10);
    figure.title = name.into();
    for layer in &mut figure.panels[0].layers {
        layer.label = Some(name.into());
    }
    // The title, also as it is drawn, and three labels.
    for (text, count) in [(svg(&figure), 5), (svg_for_page(&figure), 4)] {
        assert!(!text.contains(['\u{1b}', '\u{202e}', '\u{200b}', '\u{fe0f}']), "{text}");
        let ends = ["a\\u001b[2J", "\\u202eb\\u200b\\ufe0f"];
        assert_eq!(ends.map(|end| text.matches(end).count()), [count, count], "{text}");
    }
}

#[test]
fn a_png_has_the_print_size_and_is_not_blank() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wave.png");
    render_png(&wave(1000), &path, false).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    // Width and height are in the header chunk.
    assert_eq!(&bytes[16..24], [2160u32.to_be_bytes(), 690u32.to_be_bytes()].concat());
    assert!(bytes.len() > 20_000, "{} bytes", bytes.len());
    assert!(render_png(&wave(10), &folder.path().join("no/wave.png"), false).is_err());
}

#[test]
fn nothing_to_draw_and_nonsense_draw_axes() {
    let nonsense = vec![(f64::NAN, 1.0), (1.0, f64::INFINITY), (2.0, 3.0)];
    for (points, log) in [(vec![], false), (nonsense.clone(), false), (nonsense, true), (vec![(-1.0, -1.0)], true)] {
        let axis = if log { Axis::log("x") } else { Axis::new("x") };
        let line = Layer::unnamed(Colour::Ink, Shape::Line(points, Stroke::Solid));
        let panel = Panel { x: axis.clone(), y: axis, height_px: 150, layers: vec![line] };
        let text = svg(&Figure { name: "empty", title: "empty".into(), caption: String::new(), panels: vec![panel] });
        assert!(!text.contains("NaN") && !text.contains("inf") && text.contains("<text"), "{text}");
    }
}

#[test]
fn ticks_are_round_and_their_labels_short() {
    use super::scale::{Coordinate, around};
    use plotters::coord::ranged1d::{BoldPoints, Ranged};
    let labels = |scale, low, high, count| -> Vec<String> {
        let axis = Coordinate::new(scale, (low, high), count);
        axis.key_points(BoldPoints(count)).into_iter().map(|tick| axis.label(tick)).collect()
    };
    assert_eq!(labels(Scale::Linear, -1.1, 1.1, 5), ["−1.0", "−0.5", "0.0", "0.5", "1.0"]);
    assert_eq!(labels(Scale::Linear, 299.1, 299.9, 4), ["299.2", "299.4", "299.6", "299.8"]);
    assert_eq!(labels(Scale::Log, 0.01, 1e6, 9), ["0.01", "0.1", "1", "10", "100", "1000", "10000", "10⁵", "10⁶"]);
    assert_eq!(labels(Scale::Log, 0.9, 11.0, 5), ["1", "2", "5", "10"]);
    // A small axis.
    assert_eq!(labels(Scale::Linear, 1.98e-4, 2.02e-4, 4), ["1.98·10⁻⁴", "2.00·10⁻⁴", "2.02·10⁻⁴"]);
    assert_eq!(labels(Scale::Linear, -1.1e-7, 1.1e-7, 4), ["−1·10⁻⁷", "0", "1·10⁻⁷"]);
    assert_eq!(around(Scale::Linear, [3.0, 3.0].into_iter()), (2.7, 3.3));
    let (low, high) = around(Scale::Linear, [2e-4, 2e-4].into_iter());
    assert!((low - 1.8e-4).abs() < 1e-12 && (high - 2.2e-4).abs() < 1e-12, "{low} {high}");
}

#[test]
fn thinning_keeps_extremes_and_ends() {
    let mut points: Vec<_> = (0..100_000).map(|n| (f64::from(n), 0.0)).collect();
    points[70_001].1 = 5.0;
    points[70_002].1 = -5.0;
    let thin = decimate::line(&points, &(0.0..99_999.0), 100);
    assert!(thin.len() <= 202 && thin.contains(&(70_001.0, 5.0)) && thin.contains(&(70_002.0, -5.0)));
    assert_eq!(decimate::line(&points[..10], &(0.0..9.0), 5), points[..10]);
    let straight = (0..50).map(|n| (n * 10, n * 20)).chain([(490, 0)]);
    assert_eq!(decimate::pixels(straight, 3), [(0, 0), (490, 980), (490, 0)]);
}
