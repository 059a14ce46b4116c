// Six VL6180X: SDA and SCL of all on the board's own, GPIO0 of each on a pin of its own.
#include <PretouchFinger.h>

const uint8_t RESET_PINS[MODULES] = {2, 3, 4, 5, 6, 7};
PretouchFinger finger(Wire, SDA, SCL, RESET_PINS, Serial);

void setup()
{
    Serial.begin(115200);
    finger.begin();
}

void loop()
{
    finger.step();
}
