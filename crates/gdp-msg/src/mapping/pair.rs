//! Pairs each field of one message type with the same field of another.

use crate::definition::{Base, Count, Definition, Field};
use crate::dialect::Dialect;

/// A pair of fields, or a field without a counterpart.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Step {
    Both(usize, usize),
    /// A field that only the sending type has.
    From(usize),
    /// A field that only the receiving type has.
    To(usize),
}

/// The reason why fields do not pair.
pub(super) enum Unpaired {
    /// The fields without a counterpart on each side.
    Left(Vec<usize>, Vec<usize>),
    /// A field whose order differs between the sides.
    Order(usize),
}

/// Pairs the fields of two types, in the order of both sides. Fields pair by name. The others pair
/// by position if both sides have the same number left and their types agree.
pub(super) fn pair(from: (Dialect, &Definition), to: (Dialect, &Definition)) -> Result<Vec<Step>, Unpaired> {
    let (f, t) = (&from.1.fields, &to.1.fields);
    let mut of: Vec<Option<usize>> = vec![None; t.len()];
    let mut left: Vec<usize> = (0..f.len()).collect();
    for same in [|a: &str, b: &str| a == b, |a: &str, b: &str| a.eq_ignore_ascii_case(b)] {
        left.retain(|index| {
            let found = (0..t.len()).find(|other| of[*other].is_none() && same(&f[*index].name, &t[*other].name));
            found.inspect(|other| of[*other] = Some(*index)).is_none()
        });
    }
    let left_to: Vec<usize> = (0..t.len()).filter(|index| of[*index].is_none()).collect();
    if !left.is_empty() && !left_to.is_empty() {
        let agree =
            left.len() == left_to.len() && left.iter().zip(&left_to).all(|(a, b)| agree(from.0, &f[*a], to.0, &t[*b]));
        if !agree {
            return Err(Unpaired::Left(left, left_to));
        }
        left.drain(..).zip(left_to).for_each(|(a, b)| of[b] = Some(a));
    }
    if !from.1.name.is_counterpart(&to.1.name) {
        let left_to: Vec<usize> = (0..t.len()).filter(|index| of[*index].is_none()).collect();
        if !left.is_empty() || !left_to.is_empty() {
            return Err(Unpaired::Left(left, left_to));
        }
    }
    steps(f.len(), &of)
}

/// Orders the pairs. `of` has the sending field for each receiving one.
fn steps(from: usize, of: &[Option<usize>]) -> Result<Vec<Step>, Unpaired> {
    let mut steps = Vec::new();
    let mut next = 0;
    for (index, source) in of.iter().enumerate() {
        match source {
            Some(source) if *source < next => return Err(Unpaired::Order(*source)),
            Some(source) => {
                for skipped in next..*source {
                    if of.contains(&Some(skipped)) {
                        return Err(Unpaired::Order(skipped));
                    }
                    steps.push(Step::From(skipped));
                }
                steps.push(Step::Both(*source, index));
                next = source + 1;
            }
            None => steps.push(Step::To(index)),
        }
    }
    steps.extend((next..from).map(Step::From));
    Ok(steps)
}

/// Returns whether two fields of different names may be the same one. Compares their types without
/// a look into nested messages.
fn agree(from: Dialect, a: &Field, to: Dialect, b: &Field) -> bool {
    let counts = match (a.count, b.count) {
        (Count::Sequence(_), Count::Sequence(_)) => true,
        (a, b) => a == b,
    };
    let is_text = |base: &Base| matches!(base, Base::String(_) | Base::WString(_));
    let bases = match (&a.base, &b.base) {
        (Base::Scalar(a), Base::Scalar(b)) => a == b || a.plain(from) == b.plain(to),
        (Base::Named(a), Base::Named(b)) => a.package() == b.package() && a.name() == b.name(),
        (Base::Time | Base::Duration, Base::Named(name)) | (Base::Named(name), Base::Time | Base::Duration) => {
            name.package() == "builtin_interfaces"
        }
        (a, b) => a == b || (is_text(a) && is_text(b)),
    };
    counts && bases
}
