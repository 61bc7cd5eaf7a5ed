//! Every vendor's programs with every other's, across the fabric: publishers with subscribers
//! ([`topics`]), servers with clients ([`calls`]).

mod calls;
mod site;
mod topics;
