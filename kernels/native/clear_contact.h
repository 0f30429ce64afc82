// Body of a stage, after springs.h: no contact forces yet.

const auto contact = values(data.contact);
for (int n = 0; n < actives; ++n) contact[active[n]] = Value{};
