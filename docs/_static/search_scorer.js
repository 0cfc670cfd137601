/* Order of search results: how-to pages and tutorials first, then the other pages, names in the code last. */
var ROOMS = [[/^(howto|made\/tutorials)\//, 60], [/^(start|trust|glossary)$/, 50], [/^theory\//, 25], [/^made\/gallery\//, 10], [/^developers\//, -20]];
var Scorer = {
  score: function (result) {
    var room = ROOMS.filter(function (r) { return r[0].test(result[0]); })[0];
    return result[4] + (room ? room[1] : 0) - (result[6] === "object" ? 60 : 0);
  },
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 0, 1: 0, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
