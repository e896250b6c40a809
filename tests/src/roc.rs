//! A receiver operating characteristic: the fraction of faults that a threshold finds, against the fraction of clean
//! runs that it calls faulty.

/// One curve: its name and its points from the strictest threshold on, each the rates of false and of true alarms.
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Colour.
    pub colour: &'static str,
    /// Points.
    pub points: Vec<(f64, f64)>,
    /// The operating point of the instrument.
    pub stands: (f64, f64),
}

impl Curve {
    /// From the scores of runs without a fault and with one; the instrument calls a run with a score above 1 faulty.
    pub fn of(name: &str, colour: &'static str, clean: &[f64], faulty: &[f64]) -> Self {
        let part = |scores: &[f64], threshold: f64| {
            scores.iter().filter(|score| **score > threshold).count() as f64 / scores.len().max(1) as f64
        };
        let mut thresholds: Vec<f64> = clean.iter().chain(faulty).copied().filter(|score| *score > 0.0).collect();
        thresholds.sort_by(|a, b| b.total_cmp(a));
        thresholds.dedup();
        let at = |threshold| (part(clean, threshold), part(faulty, threshold));
        Self { name: name.into(), colour, points: thresholds.into_iter().map(at).collect(), stands: at(1.0) }
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
    let mut line = |from: (f64, f64), to: (f64, f64), colour: &str| {
        text += &format!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{colour}\"/>\n",
            from.0, from.1, to.0, to.1
        );
    };
    for part in [1e-3, 1e-2, 1e-1, 1.0] {
        line((x(part), top), (x(part), top + height), "#ddd");
    }
    for part in [0.0, 0.2, 0.4, 0.6, 0.8, 1.0] {
        line((left, y(part)), (left + width, y(part)), "#ddd");
    }
    let mut word = |at: (f64, f64), anchor: &str, turn: &str, word: &str| {
        text += &format!("<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\"{turn}>{word}</text>\n", at.0, at.1);
    };
    for (part, name) in [(1e-3, "0.1 % or less"), (1e-2, "1 %"), (1e-1, "10 %"), (1.0, "100 %")] {
        word((x(part), top + height + 16.0), if part == 1.0 { "end" } else { "middle" }, "", name);
    }
    for part in [0, 20, 40, 60, 80, 100] {
        word((left - 6.0, y(f64::from(part) / 100.0) + 4.0), "end", "", &format!("{part} %"));
    }
    word((left + width / 2.0, top + height + 34.0), "middle", "", "clean runs called faulty");
    let middle = top + height / 2.0;
    word((16.0, middle), "middle", &format!(" transform=\"rotate(-90 16 {middle:.1})\""), "harmful defects found");
    for (place, curve) in curves.iter().enumerate() {
        let mut points = format!("{:.1},{:.1}", x(0.0), y(0.0));
        let mut last = 0.0;
        for (false_part, true_part) in &curve.points {
            // Draw a staircase: the rate is constant between two thresholds.
            points += &format!(" {:.1},{:.1} {:.1},{:.1}", x(*false_part), y(last), x(*false_part), y(*true_part));
            last = *true_part;
        }
        let row = top + height + 54.0 + 18.0 * place as f64;
        let (false_part, true_part) = curve.stands;
        text += &format!(
            "<polyline points=\"{points}\" fill=\"none\" stroke=\"{0}\" stroke-width=\"1.5\"/>\n\
             <circle cx=\"{1:.1}\" cy=\"{2:.1}\" r=\"5\" fill=\"{0}\"/>\n\
             <circle cx=\"{3:.1}\" cy=\"{4:.1}\" r=\"5\" fill=\"{0}\"/>\n\
             <text x=\"{5:.1}\" y=\"{6:.1}\">{7}: {8:.1} % found, {9:.2} % false</text>\n",
            curve.colour,
            x(false_part),
            y(true_part),
            left + 6.0,
            row - 4.0,
            left + 18.0,
            row,
            curve.name,
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
