//! Setters for structs of parameters, which are `#[non_exhaustive]` so that they may grow.
//!
//! Written by one macro, so that a struct lists its fields a second time and nothing more; no cost at run time.

/// Gives a struct a method per field that sets it and hands the struct back:
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
