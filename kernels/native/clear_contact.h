// Body of a stage, after springs.h: no contact forces yet.

const auto contact = values(data.contact);
int* in_contact = &wp::index(data.in_contact, unit, 0);
for (int n = 0; n < actives; n += 2) {
    if (!in_contact[active[n] / 2]) continue;
    contact[active[n]] = contact[active[n + 1]] = Value{};
    in_contact[active[n] / 2] = 0;
}
