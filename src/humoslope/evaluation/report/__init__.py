"""Tables and figures of results, beside the paper's."""
