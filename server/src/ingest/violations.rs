//! What is wrong with a log, field by field.

use std::fmt;

use backlot_engine::ErrorKind;

/// A log with thousands of broken frames must not make a reply of megabytes.
const MAX_REPORTED: usize = 32;

/// One thing wrong with one field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldViolation {
    /// Path in the message, e.g. `frames[12].image`.
    pub field: String,
    /// For people; names the camera and frame where there is one.
    pub description: String,
}

/// Everything found wrong, in order of discovery; the first 32 in words, the rest counted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Violations {
    reported: Vec<FieldViolation>,
    unreported: usize,
}

impl Violations {
    pub fn push(&mut self, field: impl Into<String>, description: impl Into<String>) {
        if self.reported.len() == MAX_REPORTED {
            self.unreported += 1;
            return;
        }
        self.reported.push(FieldViolation {
            field: field.into(),
            description: description.into(),
        });
    }

    pub fn append(&mut self, other: Self) {
        for violation in other.reported {
            self.push(violation.field, violation.description);
        }
        self.unreported += other.unreported;
    }

    pub fn is_empty(&self) -> bool {
        self.reported.is_empty()
    }

    pub fn reported(&self) -> &[FieldViolation] {
        &self.reported
    }

    /// `Ok(value)` if nothing is wrong.
    ///
    /// # Errors
    /// `self` otherwise.
    pub fn into_result<T>(self, value: T) -> Result<T, Self> {
        if self.is_empty() {
            Ok(value)
        } else {
            Err(self)
        }
    }

    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Invalid
    }
}

impl fmt::Display for Violations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, violation) in self.reported.iter().enumerate() {
            let separator = if i == 0 { "" } else { "; " };
            write!(
                f,
                "{separator}{}: {}",
                violation.field, violation.description
            )?;
        }
        if self.unreported > 0 {
            write!(f, "; and {} more", self.unreported)?;
        }
        Ok(())
    }
}

impl std::error::Error for Violations {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn report_is_bounded_and_counts_the_rest() {
        let mut all = Violations::default();
        for i in 0..100 {
            all.push(format!("frames[{i}].image"), "is missing");
        }
        assert_eq!(all.reported().len(), MAX_REPORTED);
        assert!(all.to_string().ends_with("; and 68 more"), "{all}");
    }
}
