//! todo
/// w
pub struct WorkDir;
