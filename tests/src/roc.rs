//! A receiver operating characteristic: the fraction of faults that a threshold finds, against the fraction of clean
//! runs that it calls faulty.

/// One curve: its name and its points from the strictest threshold on, each the rates of false and of true alarms.
pub struct Curve {
    /// Name in the legend.
    pub name: &'static str,
    /// Colour.
    pub colour: &'static str,
    /// Points.
    pub points: Vec<(f64, f64)>,
    /// The operating point of the instrument.
    pub stands: (f64, f64),
}

impl Curve {
    /// From the scores of runs without a fault and with one; the instrument calls a run with a score above 1 faulty.
    pub fn of(name: &'static str, colour: &'static str, clean: &[f64], faulty: &[f64]) -> Self {
        let part = |scores: &[f64], threshold: f64| {
            scores.iter().filter(|score| **score > threshold).count() as f64 / scores.len().max(1) as f64
        };
        let mut thresholds: Vec<f64> = clean.iter().chain(faulty).copied().filter(|score| *score > 0.0).collect();
        thresholds.sort_by(|a, b| b.total_cmp(a));
        thresholds.dedup();
        let at = |threshold| (part(clean, threshold), part(faulty, threshold));
        Self { name, colour, points: thresholds.into_iter().map(at).collect(), stands: at(1.0) }
    }
}

/// Left, top, width and height of the plane \[px\].
const PLANE: [f64; 4] = [64.0, 16.0, 420.0, 300.0];
/// The smallest rate of false alarms that is drawn.
const LEAST: f64 = 1e-3;

/// The curves as an SVG, with the rate of false alarms on a logarithmic axis.
pub fn svg(curves: &[Curve]) -> String {
    let [left, top, width, height] = PLANE;
    let x = |part: f64| left + width * (part.max(LEAST) / LEAST).log10() / -LEAST.log10();
    let y = |part: f64| top + height * (1.0 - part);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.0} {:.0}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        left + width + 16.0,
        top + height + 52.0 + 18.0 * curves.len() as f64
    );
    let line = |x1: f64, y1: f64, x2: f64, y2: f64| {
        format!("<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"#ddd\"/>\n")
    };
    let word = |x: f64, y: f64, anchor: &str, turn: &str, word: &str| {
        format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\"{turn}>{word}</text>\n")
    };
    let bottom = top + height;
    let mut words = String::new();
    for (part, name) in [(1e-3, "0.1 % or less"), (1e-2, "1 %"), (1e-1, "10 %"), (1.0, "100 %")] {
        text += &line(x(part), top, x(part), bottom);
        words += &word(x(part), bottom + 16.0, if part == 1.0 { "end" } else { "middle" }, "", name);
    }
    for percent in [0, 20, 40, 60, 80, 100] {
        let y = y(f64::from(percent) / 100.0);
        text += &line(left, y, left + width, y);
        words += &word(left - 6.0, y + 4.0, "end", "", &format!("{percent} %"));
    }
    words += &word(left + width / 2.0, bottom + 34.0, "middle", "", "clean runs called faulty");
    let middle = top + height / 2.0;
    let turn = format!(" transform=\"rotate(-90 16 {middle:.1})\"");
    text += &(words + &word(16.0, middle, "middle", &turn, "harmful defects found"));
    for (place, curve) in curves.iter().enumerate() {
        let mut points = format!("{:.1},{:.1}", x(0.0), y(0.0));
        let mut last = 0.0;
        for (false_part, true_part) in &curve.points {
            // Draw a staircase: the rate is constant between two thresholds.
            points += &format!(" {0:.1},{1:.1} {0:.1},{2:.1}", x(*false_part), y(last), y(*true_part));
            last = *true_part;
        }
        let row = bottom + 54.0 + 18.0 * place as f64;
        let Curve { name, colour, stands: (false_part, true_part), .. } = curve;
        text += &format!(
            "<polyline points=\"{points}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\n\
             <circle cx=\"{0:.1}\" cy=\"{1:.1}\" r=\"5\" fill=\"{colour}\"/>\n\
             <circle cx=\"{2:.1}\" cy=\"{3:.1}\" r=\"5\" fill=\"{colour}\"/>\n\
             <text x=\"{4:.1}\" y=\"{row:.1}\">{name}: {5:.1} % found, {6:.2} % false</text>\n",
            x(*false_part),
            y(*true_part),
            left + 6.0,
            row - 4.0,
            left + 18.0,
            100.0 * true_part,
            100.0 * false_part,
        );
    }
    text + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_goes_up_with_what_is_found() {
        let curve = Curve::of("law", "black", &[0.2, 0.4, 1.2, 0.3], &[0.1, 2.0, 3.0, 1.1]);
        assert_eq!(curve.stands, (0.25, 0.75));
        assert_eq!(curve.points.first(), Some(&(0.0, 0.0)));
        assert!(curve.points.windows(2).all(|pair| pair[0].0 <= pair[1].0 && pair[0].1 <= pair[1].1));
        let drawn = svg(&[curve]);
        assert!(
            drawn.starts_with("<svg") && drawn.ends_with("</svg>\n") && drawn.contains("75.0 % found, 25.00 % false")
        );
    }
}
