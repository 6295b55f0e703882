/* SPDX-License-Identifier: MIT
 * The texts that the voices speak. */
#ifndef ERN_TESTS_TEXTS_H
#define ERN_TESTS_TEXTS_H

static const char english[] =
    "Every morning my uncle Paul walks along the old harbour wall and counts the boats that came home in the night. "
    "Some are painted blue, some are brown, and one of them has no colour left at all. He buys a warm loaf of bread, "
    "a bag of apples and a paper, and he sits down on a bench by the water to read about the weather. The news is "
    "rarely good, but he likes the pictures. In the afternoon the children arrive from school. They throw pebbles as "
    "far as they can, they argue about whose turn it is, and they ask him why the moon moves when they move. He tells "
    "them that the moon is shy, and that it follows only people who never stop talking. When the wind turns to the "
    "west we close the shutters, light the fire and wait for the rain. My mother makes a thick soup of beans and "
    "potatoes, and my father plays the same four songs on the piano until somebody begs him to stop. Once, long ago, a "
    "storm carried our kitchen roof over the hill and dropped it in a field full of sheep. Nobody was hurt, and the "
    "sheep seemed to enjoy it. People in the village still ask whether we have found a better roof, and we always "
    "answer that this one has not flown away so far.";
static const char german[] =
    "Am Abend geht der Bäcker noch einmal durch die Stube und löscht das Licht. Draußen fällt leiser Regen auf "
    "die Dächer, und vom Fluss her hört man die Boote. Seine Frau liest den Kindern eine Geschichte vor, in der ein "
    "kleiner Bär das Meer sucht und überall nur Pfützen findet. Morgen früh um vier beginnt die Arbeit, denn "
    "das Brot soll warm sein, wenn die ersten Leute kommen und über das Wetter klagen.";
static const char spanish[] =
    "Cada domingo mi abuela abre las ventanas de la casa y pone la mesa bajo el árbol grande del patio. Vienen los "
    "primos, los vecinos y hasta el perro del panadero, que nunca se pierde una comida. Hablamos de todo un poco: del "
    "campo, de la lluvia que no llega, de aquel viaje al mar que nadie olvida. Por la tarde alguien toma la guitarra, "
    "y los niños bailan hasta que se hace de noche.";

struct spoken_text {
  const char *name, *text, *voice;
  int words_per_minute;
};
/* The first one is the training text. */
static const struct spoken_text spoken_texts[] = {
    {"same voice", english, "en-us", 165}, {"British", english, "en", 165},
    {"f3", english, "en-us+f3", 165},      {"Scottish m3", english, "en-gb-scotland+m3", 165},
    {"f2", english, "en-us+f2", 170},      {"German", german, "de", 160},
    {"Spanish", spanish, "es", 160},       {"20 % faster", english, "en-us", 198},
};

#endif
