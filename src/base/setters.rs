//! Setters for structs of parameters, which are `#[non_exhaustive]` so that they may grow.
//!
//! One macro writes them, so a struct only lists its fields a second time; no cost at run time.

/// Gives a struct one method per field, which sets it and returns the struct:
/// `Params::default().width(800).height(600)`.
macro_rules! setters {
    ($name:ident { $($field:ident: $type:ty),+ $(,)? }) => {
        impl $name {
            $(
                #[doc = concat!("Sets `", stringify!($field), "`.")]
                #[must_use]
                pub fn $field(mut self, $field: $type) -> Self {
                    self.$field = $field;
                    self
                }
            )+
        }
    };
}
pub(crate) use setters;
