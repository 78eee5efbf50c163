//! Response curves R from exposure to pixel value, with true inverses (design §2).

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::SensorError;
use crate::video::ending;
use crate::{At, Result};

/// Shape of a response curve on the unit square: u = x/x_sat in [0, 1] → y in [0, 1].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// y = u.
    Linear,
    /// y = u^(1/γ).
    Gamma(f64),
    /// Linear up to `knee`, then bending smoothly (slope continuous) into y = 1 at u = 1:
    /// with s = (u − k)/(1 − k), y = k' + (1 − k')·(1 − (1 − s)^n), where k' and n follow from k.
    SoftKnee(f64),
    /// Monotone table: pairs (u, y), both rising from 0 to 1, linear in between.
    Table(Vec<(f64, f64)>),
}

/// How much steeper than the mean the linear part of a soft-knee curve is.
const KNEE_GAIN: f64 = 1.25;

/// A response curve R with its saturation exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    form: Form,
    /// x_sat: exposure value in p·frames at which the pixel saturates.
    saturation: f64,
}

impl Response {
    /// A response that saturates at `saturation` p·frames.
    pub fn new(form: Form, saturation: f64) -> Result<Self, SensorError> {
        let fail = |problem: String| Err(SensorError::Response(problem));
        if !(saturation.is_finite() && saturation > 0.0) {
            return fail(format!("a saturation exposure of {saturation}"));
        }
        match &form {
            Form::Linear => {}
            Form::Gamma(gamma) if (0.1..=10.0).contains(gamma) => {}
            Form::Gamma(gamma) => return fail(format!("gamma {gamma}; 0.1 to 10 can be used")),
            Form::SoftKnee(knee) if (0.0..=0.75).contains(knee) => {}
            Form::SoftKnee(knee) => return fail(format!("knee {knee}; 0 to 0.75 can be used")),
            Form::Table(rows) => check_table(rows)?,
        }
        Ok(Self { form, saturation })
    }

    /// Whether a file of this name holds a measured response, which [`Response::read_form`] reads.
    pub fn is_measured(name: &str) -> bool {
        ending(Path::new(name)) == "csv"
    }

    /// Reads a measured response: CSV with two columns, exposure (any unit) and pixel value (any unit), rising.
    /// A first row that does not begin with a number is a heading. The first row is x = 0, the last one saturation.
    pub fn read_form(path: impl AsRef<Path>) -> Result<Form> {
        let path = path.as_ref();
        Self::parse_form(&super::text::read_text(path).at(path)?).at(path)
    }

    /// As [`Response::read_form`], from text.
    pub fn parse_form(text: &str) -> Result<Form, SensorError> {
        let mut rows: Vec<(usize, f64, f64)> = Vec::new();
        let mut begun = false;
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let fields = line.split([',', ';', '\t', ' ']).filter(|field| !field.is_empty());
            let mut fields = fields.map(str::parse::<f64>);
            let is_first = !std::mem::replace(&mut begun, true);
            match (fields.next(), fields.next()) {
                (Some(Ok(x)), Some(Ok(y))) if x.is_finite() && y.is_finite() => rows.push((index + 1, x, y)),
                (Some(Err(_)), _) if is_first => {} // heading
                _ => {
                    return Err(SensorError::Response(format!(
                        "row {}: '{line}' is not two numbers",
                        index + 1
                    )));
                }
            }
        }
        let (Some(&(_, x0, y0)), Some(&(_, x1, y1))) = (rows.first(), rows.last()) else {
            return Err(SensorError::Response("the table has no rows".into()));
        };
        for pair in rows.windows(2) {
            let ((_, xa, ya), (row, xb, yb)) = (pair[0], pair[1]);
            if xb <= xa || yb < ya {
                return Err(SensorError::Response(format!(
                    "row {row}: ({xb}, {yb}) after ({xa}, {ya}); exposure must rise and pixel values must not fall"
                )));
            }
        }
        if rows.len() < 2 || y1 <= y0 {
            return Err(SensorError::Response("the table needs two rows with different pixel values".into()));
        }
        if !((x1 - x0).is_finite() && (y1 - y0).is_finite()) {
            return Err(SensorError::Response("the table's range is too wide".into()));
        }
        let unit = |&(_, x, y): &(usize, f64, f64)| ((x - x0) / (x1 - x0), (y - y0) / (y1 - y0));
        Ok(Form::Table(rows.iter().map(unit).collect()))
    }

    /// The curve on the unit square.
    pub fn form(&self) -> &Form {
        &self.form
    }

    /// x_sat in p·frames.
    pub fn saturation(&self) -> f64 {
        self.saturation
    }

    /// y = R(x); 0 below 0, 1 at saturation and above.
    pub fn value(&self, x: f64) -> f64 {
        let u = (x / self.saturation).clamp(0.0, 1.0);
        match &self.form {
            Form::Linear => u,
            Form::Gamma(gamma) => u.powf(gamma.recip()),
            Form::SoftKnee(knee) => {
                let (k, v, n) = knee_constants(*knee);
                if u <= k {
                    KNEE_GAIN * u
                } else {
                    v + (1.0 - v) * (1.0 - (1.0 - (u - k) / (1.0 - k)).powf(n))
                }
            }
            Form::Table(rows) => interpolate(rows, u, |row| row.0, |row| row.1),
        }
    }

    /// x = R⁻¹(y); 0 below 0, x_sat at 1 and above. Where the curve is flat, the largest x that gives y.
    pub fn exposure(&self, y: f64) -> f64 {
        let y = y.clamp(0.0, 1.0);
        let u = match &self.form {
            Form::Linear => y,
            Form::Gamma(gamma) => y.powf(*gamma),
            Form::SoftKnee(knee) => {
                let (k, v, n) = knee_constants(*knee);
                if y <= v {
                    y / KNEE_GAIN
                } else {
                    k + (1.0 - k) * (1.0 - ((1.0 - y) / (1.0 - v)).powf(n.recip()))
                }
            }
            Form::Table(rows) => interpolate(rows, y, |row| row.1, |row| row.0),
        };
        self.saturation * if y >= 1.0 { 1.0 } else { u }
    }
}

/// Knee, its pixel value, and the exponent that makes the slope continuous there.
fn knee_constants(knee: f64) -> (f64, f64, f64) {
    let value = KNEE_GAIN * knee;
    (knee, value, KNEE_GAIN * (1.0 - knee) / (1.0 - value))
}

/// Value of `output` where `input` is `at`, linear between rows that rise in `input`.
fn interpolate(
    rows: &[(f64, f64)],
    at: f64,
    input: impl Fn(&(f64, f64)) -> f64,
    output: impl Fn(&(f64, f64)) -> f64,
) -> f64 {
    let above = rows.partition_point(|row| input(row) <= at).clamp(1, rows.len() - 1);
    let (a, b) = (&rows[above - 1], &rows[above]);
    let width = input(b) - input(a);
    if width <= 0.0 {
        return output(b);
    }
    let share = ((at - input(a)) / width).clamp(0.0, 1.0);
    output(a) + share * (output(b) - output(a))
}

fn check_table(rows: &[(f64, f64)]) -> Result<(), SensorError> {
    let ends = rows.len() >= 2 && rows[0] == (0.0, 0.0) && rows[rows.len() - 1] == (1.0, 1.0);
    if !ends {
        return Err(SensorError::Response("a table runs from (0, 0) to (1, 1)".into()));
    }
    match rows.windows(2).position(|pair| !(pair[1].0 > pair[0].0 && pair[1].1 >= pair[0].1)) {
        Some(row) => Err(SensorError::Response(format!("row {}: the table does not rise", row + 2))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forms() -> Vec<Form> {
        let table = Response::parse_form("x,y\n0,10\n1,40\n2.5,60\n8,250\n").unwrap();
        vec![Form::Linear, Form::Gamma(2.2), Form::SoftKnee(0.6), Form::SoftKnee(0.0), table]
    }

    #[test]
    fn inverse_is_true() {
        for form in forms() {
            let response = Response::new(form, 2.0).unwrap();
            for i in 0..=1000 {
                let x = 2.0 * f64::from(i) / 1000.0;
                let y = response.value(x);
                assert!((0.0..=1.0).contains(&y));
                assert!((response.exposure(y) - x).abs() < 1e-9, "{:?} at {x}", response.form());
                let y = f64::from(i) / 1000.0;
                assert!((response.value(response.exposure(y)) - y).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn saturation_inverts_to_saturation() {
        for form in forms() {
            let response = Response::new(form, 2.0).unwrap();
            assert_eq!(response.value(2.0), 1.0);
            assert_eq!(response.value(50.0), 1.0);
            assert_eq!(response.exposure(1.0), 2.0);
            assert_eq!(response.exposure(3.0), 2.0);
            assert_eq!(response.value(-1.0), 0.0);
        }
    }

    #[test]
    fn only_the_first_row_may_be_a_heading() {
        let table = Response::parse_form("# camera 3\n\nexposure value\n0 1\n2\t40\n 8   250\n").unwrap();
        assert_eq!(table, Response::parse_form("0,1\n2,40\n8,250\n").unwrap());
        for (text, row) in [("x,y\n0,n/a\n1,40\n2,60\n", "row 2"), ("0,n/a\n1,40\n2,60\n", "row 1")] {
            let error = Response::parse_form(text).unwrap_err().to_string();
            assert!(error.contains(row), "{error}");
        }
    }

    #[test]
    fn falling_table_is_refused_with_its_row() {
        let error = Response::parse_form("x,y\n0,0\n1,5\n2,4\n").unwrap_err().to_string();
        assert!(error.contains("row 4"), "{error}");
        let error = Response::parse_form("0,0\n1,what\n").unwrap_err().to_string();
        assert!(error.contains("row 2"), "{error}");
        assert!(Response::parse_form("").is_err());
    }
}
