//! Forward selection: which columns explain most of what the law leaves over.

/// Part of a column's square that the law and what has been added must leave over.
const LEAST_LEFT: f64 = 0.005;
/// Parts of a run, of which all but one must agree.
const PARTS: usize = 10;

/// Columns by which a residual is explained, made orthogonal to all that has been.
pub(super) struct Selection {
    residual: Vec<f64>,
    /// Regressors so far.
    taken: usize,
    per_observation: f64,
}

/// A group of columns, and what their squares were at first.
#[derive(Clone)]
pub(super) struct Group {
    columns: Vec<Vec<f64>>,
    squares: Vec<f64>,
}

impl Group {
    pub fn new(columns: Vec<Vec<f64>>) -> Self {
        let squares = columns.iter().map(|column| dot(column, column)).collect();
        Self { columns, squares }
    }

    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Takes a direction out of the columns.
    pub fn leave_out(&mut self, direction: &[f64]) {
        self.columns.iter_mut().for_each(|column| subtract(column, direction));
    }

    /// Directions that the group adds; none where less than this part of one is left over.
    fn directions(&self, least_left: f64) -> Option<Vec<Vec<f64>>> {
        let mut directions: Vec<Vec<f64>> = Vec::new();
        for (column, square) in self.columns.iter().zip(&self.squares) {
            let mut left = column.clone();
            directions.iter().for_each(|direction| subtract(&mut left, direction));
            let length = dot(&left, &left);
            if length.is_nan() || length <= least_left * square {
                return None;
            }
            left.iter_mut().for_each(|value| *value /= length.sqrt());
            directions.push(left);
        }
        Some(directions)
    }
}

impl Selection {
    pub fn new(force: &[f64], per_observation: f64) -> Self {
        Self { residual: force.to_vec(), taken: 0, per_observation }
    }

    /// Independent observations.
    fn observations(&self) -> f64 {
        self.residual.len() as f64 / self.per_observation
    }

    /// Root mean square of what is left over.
    pub fn residual_rms(&self) -> f64 {
        (dot(&self.residual, &self.residual) / self.residual.len() as f64).sqrt()
    }

    /// F statistic of a group: the square that each of its directions explains, over what is left for each free observation.
    /// Neighbouring rows agree, in the residual as in the columns, so one row is a part of an observation in both;
    /// 0 where the size of a single column cannot be.
    pub fn statistic(&self, group: &Group, can_be: impl Fn(f64) -> bool) -> f64 {
        let Some(directions) = group.directions(LEAST_LEFT) else { return 0.0 };
        let parts: Vec<f64> = directions.iter().map(|direction| dot(direction, &self.residual)).collect();
        let explained: f64 = parts.iter().map(|part| part * part).sum();
        if let ([direction], [column]) = (directions.as_slice(), group.columns.as_slice())
            && !can_be(dot(direction, &self.residual) / dot(direction, column))
        {
            return 0.0;
        }
        let freedom = self.observations() - (self.taken + group.len()) as f64;
        let left = (dot(&self.residual, &self.residual) - explained).max(f64::MIN_POSITIVE);
        if freedom < 1.0 {
            return 0.0;
        }
        // What happened once is no cause: the part of the run that says most is left out.
        let length = self.residual.len().div_ceil(PARTS).max(1);
        let of_part = |place: usize| {
            let within = place * length..((place + 1) * length).min(self.residual.len());
            let said = |(direction, part): (&Vec<f64>, &f64)| {
                part * dot(
                    direction.get(within.clone()).unwrap_or_default(),
                    self.residual.get(within.clone()).unwrap_or_default(),
                )
            };
            directions.iter().zip(&parts).map(said).sum::<f64>()
        };
        let most = (0..PARTS).map(of_part).fold(0.0, f64::max);
        let agreed = ((explained - most).max(0.0) * PARTS as f64 / (PARTS - 1) as f64).min(explained);
        agreed / group.len() as f64 / (left / freedom)
    }

    /// Takes a group in; gives its directions.
    pub fn take(&mut self, group: &Group) -> Vec<Vec<f64>> {
        let directions = group.directions(0.0).unwrap_or_default();
        directions.iter().for_each(|direction| subtract(&mut self.residual, direction));
        self.taken += directions.len();
        directions
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn subtract(column: &mut [f64], direction: &[f64]) {
    let part = dot(column, direction);
    column.iter_mut().zip(direction).for_each(|(value, unit)| *value -= part * unit);
}
